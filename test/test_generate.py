"""Committed files are those that `make generate` would write."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
import sys

import pytest

pytest.importorskip('rclpy')
ROOT = Path(__file__).resolve().parents[1]
GENERATED = (('msg_schemas', '*/*'), ('docs/checkpoints', '*.md'), ('docs/reference', '*.md'))


def test_nothing_that_is_committed_differs_from_what_would_be_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, 'path', [str(ROOT / 'scripts'), *sys.path])
    fresh = dict(import_module('generate').fresh())
    for name, content in fresh.items():
        assert (ROOT / name).read_text(encoding='utf-8') == content, f'{name}: run make generate'
    for folder, pattern in GENERATED:
        stored = {str(path.relative_to(ROOT)) for path in (ROOT / folder).glob(pattern)}
        assert stored == {name for name in fresh if Path(name).match(f'{folder}/{pattern}')}
