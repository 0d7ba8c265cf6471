"""Reader of bags: a folder of MCAP files, with or without metadata.yaml, or one file."""

from __future__ import annotations

import os
from pathlib import Path
import re

from shepherd_ros.rosbag2.bag import Bag, recover_hint
from shepherd_ros.rosbag2.errors import BagError, unreadable
from shepherd_ros.rosbag2.metadata import FILE, Metadata, STORAGE
from shepherd_ros.rosbag2.qos import MAX_YAML_BYTES


def open_bag(path: Path | str) -> Bag:
    """Return the bag in a folder or a single .mcap, .db3 or .bag file; raises BagError."""
    path = Path(path)
    try:
        folder, exists = path.is_dir(), path.exists()
    except OSError as error:
        raise unreadable(path, error) from error
    if not exists:
        raise BagError(path, 'there is no such file or folder', 'check the path')
    metadata = read_metadata(path / FILE) if folder and (path / FILE).exists() else None
    packed = metadata and metadata.compression_mode.lower() not in ('', 'none')
    if packed or (metadata and metadata.storage != STORAGE) or path.suffix in ('.db3', '.bag'):
        from shepherd_ros.rosbag2.other_bags import OtherBag  # only these need all of rosbags

        return OtherBag(path, metadata)
    return Bag(path, _files(path, metadata) if folder else [path], metadata)


def bags_in(place: Path) -> list[Path]:
    """
    Return the bags at a place, which is one itself or a folder of some; [] if it is neither.

    Hidden folders are those of runs that were killed, and left out.
    """

    def is_bag(path: Path) -> bool:
        return path.suffix == '.mcap' or (path / FILE).exists() or any(path.glob('*.mcap'))

    try:
        if is_bag(place):
            return [place]
        inside = sorted(p for p in place.iterdir() if p.is_dir() and p.name[0] != '.')
        return [path for path in inside if is_bag(path)]
    except OSError:
        return []


def _files(folder: Path, metadata: Metadata | None) -> list[Path]:
    """Return the files of a bag in order; raises BagError."""
    metadata_path = folder / FILE
    if metadata is None:
        return mcap_files(folder)
    files = [folder / Path(file.path).name for file in metadata.files]
    if not files:
        raise BagError(metadata_path, 'it names no file')
    for file in files:
        if not file.is_file():
            raise BagError(file, f'it is not there, but {FILE} names it', recover_hint(folder))
    return files


def read_metadata(path: Path) -> Metadata:
    """Return the metadata of a metadata.yaml; raises BagError."""
    if not path.is_file():  # a pipe would never end
        raise BagError(path, 'it is no file', 'expected the folder of a bag')
    try:
        with path.open('rb') as file:
            data = file.read(min(os.fstat(file.fileno()).st_size, MAX_YAML_BYTES) + 1)
    except OSError as error:
        raise unreadable(path, error) from error
    fix = f'run `shepherd bag recover {path.parent}` to write it again'
    try:
        return Metadata.from_yaml(data.decode(), path)
    except BagError as error:
        raise BagError(path, error.reason, fix) from error
    except UnicodeDecodeError as error:
        raise BagError(path, 'it is no text', fix) from error


def mcap_files(folder: Path) -> list[Path]:
    """Return the MCAP files of a folder, <name>_2.mcap before <name>_10.mcap; raises BagError."""

    def order(path: Path) -> tuple[int, str]:
        number = re.search(r'_(\d{1,18})$', path.stem)
        return int(number[1]) if number else -1, path.name

    try:
        files = [path for path in folder.iterdir() if path.suffix == '.mcap' and path.is_file()]
    except OSError as error:
        raise unreadable(folder, error) from error
    if not files:
        raise BagError(folder, 'it holds no .mcap file', 'expected the folder of a bag')
    return sorted(files, key=order)
