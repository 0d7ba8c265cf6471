"""Folders that verbs write into."""

from __future__ import annotations

from collections.abc import Mapping
import json
import os
from pathlib import Path
import shutil
from typing import Any

from shepherd_ros.cli.user_error import UserError

MADE_BY = '.made_by.json'  # hidden, so that bags/* are bags


def made_folder(option: str, folder: Path) -> None:
    """Make a folder unless it is there; UserError if it cannot be made or written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f'{option} is {folder}: expected a folder ({error.strerror})') from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise UserError(f'{option} is {folder}: expected a folder that can be written')


def claimed_folder(option: str, folder: Path, marks: str, overwrite: bool | None = None) -> None:
    """
    Make a folder that a verb writes into; UserError if others have written into it.

    marks are patterns, with spaces between them, of files that tell a folder of this verb. None:
    the verb has no --overwrite.
    """
    made_folder(option, folder)
    files = sorted(path.name for path in folder.iterdir() if path.name[0] != '.')
    own = any(next(folder.glob(mark), None) for mark in marks.split())
    if files and not (own or overwrite):
        more = '' if overwrite is None else '; --overwrite writes beside what is there'
        again = ', or one that was written by the same command' if marks else ''
        raise UserError(
            f'{option} is {folder}, which holds something else, such as {files[0]}: expected a '
            f'new folder{again}{more}'
        )


def new_file(option: str, path: Path, overwrite: bool) -> None:
    """Make the folder of a file; UserError if the file is there already."""
    made_folder(option, path.parent)
    if path.is_dir():
        raise UserError(f'{option} is {path}, a folder: expected the name of a file')
    if path.exists() and not overwrite:
        raise UserError(
            f'{option} is {path}, which is there already: expected a new file; --overwrite '
            'replaces it'
        )


def own_folder(folder: Path, made_by: Mapping[str, Any], resume: bool, overwrite: bool) -> None:
    """
    Make the folder of episodes that made_by describes; UserError if it holds something else.

    resume goes on all the same, overwrite deletes the episodes that are there.
    """
    made_folder('--out', folder)
    file, text = folder / MADE_BY, json.dumps(made_by, indent=2, sort_keys=True)
    same = file.exists() and file.read_text(encoding='utf-8') == text
    if any(folder.iterdir()) and not (same or resume or overwrite):
        raise UserError(
            f'--out is {folder}, which holds something else: expected an empty folder, or one of '
            f'the same options, as {MADE_BY} has them; --resume goes on in it, --overwrite '
            'deletes its episodes'
        )
    for path in folder.glob('episode_*') if overwrite else ():
        shutil.rmtree(path)
    file.write_text(text, encoding='utf-8')
