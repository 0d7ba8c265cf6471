#!/usr/bin/env python3
"""Write docs/checkpoints/<name>.md anew from the checkpoints that are shipped."""

from pathlib import Path

from shepherd_ros.policy.card import card
from shepherd_ros.policy.checkpoint import (
    checkpoint_file,
    load_policy,
    read_metadata,
    shipped_checkpoints,
)

FOLDER = Path(__file__).parent.parent / 'docs' / 'checkpoints'

if __name__ == '__main__':
    FOLDER.mkdir(exist_ok=True)
    for name in shipped_checkpoints():
        record = read_metadata(checkpoint_file(name))[1]
        text = card(name, load_policy(name), record)
        (FOLDER / f'{name}.md').write_text(text, encoding='utf-8')
