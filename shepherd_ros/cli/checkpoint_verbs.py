"""Verbs checkpoint info, card, random and export."""

from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text
from shepherd_ros.arguments import verb_group
from shepherd_ros.cli.out_folders import new_file
from shepherd_ros.cli.user_error import UserError
import tyro

CheckpointName = tyro.conf.Positional[str]
NAME_WIDTH = 20  # [characters] of the first column of a page
EXPORT_TOLERANCE = 1e-4  # largest difference of an exported network's outputs


@dataclass
class _Info:
    """Show what a checkpoint was trained on, how, and how good it is; without arguments, list."""

    checkpoint: CheckpointName = ''
    """A file, or the name of a shipped one."""
    weights: bool = False
    """Also list the weights."""
    json: bool = False
    """Print JSON: all that the file says, the whole configuration of its training too."""

    def run(self) -> int:
        """Print the page or the list; return the exit code."""
        from shepherd_ros.policy.checkpoint import (
            checkpoint_file,
            load_policy,
            read_checkpoint_metadata,
            shipped_checkpoints,
        )
        from shepherd_ros.policy.record_rows import record_rows
        from shepherd_ros.recordings.info import size_text

        if not self.checkpoint:
            print('\n'.join(shipped_checkpoints()) or 'no checkpoint is shipped')
            return 0
        path = checkpoint_file(self.checkpoint)
        config, record, version = read_checkpoint_metadata(path)
        shapes = {}
        if self.weights:
            state = load_policy(self.checkpoint).state_dict()
            shapes = {name: tuple(value.shape) for name, value in state.items()}
        if self.json:
            about = {
                'file': str(path),
                'size': path.stat().st_size,
                'version': version,
                'policy': config.to_dict(),
                'record': record,
                **({'weights': shapes} if self.weights else {}),
            }
            print(_json(about, path))
            return 0
        console = Console(highlight=False)
        console.print(f'{path}, {size_text(path.stat().st_size)}', soft_wrap=True, markup=False)
        parts = dict(record_rows(config, record, version))
        if self.weights:
            parts['Weights'] = [(name, str(shape)) for name, shape in shapes.items()]
        for title, rows in parts.items():
            if not rows:
                continue
            grid = Table.grid(padding=(0, 2))
            grid.add_column(width=NAME_WIDTH)
            grid.add_column(overflow='fold')
            for name, value in rows:
                grid.add_row(Text(name), Text(value))
            console.print(Text(f'\n{title}', style='bold'))
            console.print(Padding(grid, (0, 0, 0, 2)))
        return 0


def _json(about: dict[str, Any], path: Path) -> str:
    """Return what a checkpoint says as JSON, or raise UserError."""
    try:
        return json.dumps(about, indent=2)
    except RecursionError:
        raise UserError(f'{path}: its record is nested too deep to be shown') from None


@dataclass
class _Card:
    """Print the model card of a checkpoint, in Markdown."""

    checkpoint: CheckpointName
    """A file, or the name of a shipped one."""

    def run(self) -> int:
        """Print the card; return the exit code."""
        from shepherd_ros.policy.card import card
        from shepherd_ros.policy.checkpoint import (
            checkpoint_file,
            load_policy,
            read_checkpoint_metadata,
        )

        path = checkpoint_file(self.checkpoint)
        print(
            card(path.stem, load_policy(self.checkpoint), read_checkpoint_metadata(path)[1]),
            end='',
        )
        return 0


@dataclass
class _RandomWeights:
    """Write a checkpoint with random weights, to try the nodes before anything is trained."""

    output: Annotated[Path, tyro.conf.arg(aliases=['-o'])]
    """File to write, *.safetensors."""
    seed: int = 0
    """Seed of the weights."""
    overwrite: bool = False
    """Replace a file that is there."""

    def run(self) -> int:
        """Write the checkpoint; return the exit code."""
        from shepherd_ros.policy.checkpoint import CHECKPOINT_SUFFIX, save_policy
        from shepherd_ros.policy.policy import Policy, PolicyConfig
        import torch

        if self.output.suffix != CHECKPOINT_SUFFIX:
            raise UserError(
                f'--output is {self.output}: expected a name that ends in {CHECKPOINT_SUFFIX}'
            )
        new_file('--output', self.output, self.overwrite)
        torch.manual_seed(self.seed)
        record = {'command': f'shepherd checkpoint random --seed {self.seed}', 'trained': False}
        save_policy(self.output, Policy(PolicyConfig()), record)
        print(f'wrote {self.output}')
        return 0


@dataclass
class _Export:
    """Write the actor for other programs, as TorchScript or ONNX, and check its outputs."""

    checkpoint: CheckpointName
    """A file, or the name of a shipped one."""
    output: Annotated[Path, tyro.conf.arg(aliases=['-o'])]
    """File to write, *.pt or *.onnx: frames (n, K, 3, R) m, newest last, to (n, 2) m/s."""
    overwrite: bool = False
    """Replace a file that is there."""

    def run(self) -> int:
        """Write the network and compare its outputs; return the exit code."""
        from shepherd_ros.policy.checkpoint import load_policy
        from shepherd_ros.policy.torchscript import export_actor

        new_file('--output', self.output, self.overwrite)
        difference = export_actor(load_policy(self.checkpoint), self.output)
        if difference > EXPORT_TOLERANCE:
            raise UserError(
                f'{self.output} differs by {difference} m/s from the policy: '
                f'expected {EXPORT_TOLERANCE}'
            )
        print(f'wrote {self.output}; largest difference {difference:.1e} m/s')
        return 0


CheckpointVerbs = verb_group(
    'Look at checkpoints, make random ones, export the network.',
    info=_Info,
    card=_Card,
    random=_RandomWeights,
    export=_Export,
)
