"""Verbs checkpoint info, card, random and export."""

from __future__ import annotations

from dataclasses import dataclass
import json
from pathlib import Path
from typing import Annotated

from shepherd_ros.arguments import verb_group
from shepherd_ros.cli.out_folders import made_folder
from shepherd_ros.cli.user_error import UserError
import tyro

CheckpointName = tyro.conf.Positional[str]
EXPORT_TOLERANCE = 1e-4  # largest difference of an exported network's outputs


@dataclass
class _Info:
    """Show what a checkpoint was trained on, how, and how good it is; without arguments, list."""

    checkpoint: CheckpointName = ''
    """A file, or the name of a shipped one."""
    weights: bool = False
    """Also list the weights."""

    def run(self) -> int:
        """Print it."""
        from shepherd_ros.policy.checkpoint import (
            checkpoint_file,
            load_policy,
            read_checkpoint_metadata,
            shipped_checkpoints,
        )

        if not self.checkpoint:
            print('\n'.join(shipped_checkpoints()) or 'no checkpoint is shipped')
            return 0
        path = checkpoint_file(self.checkpoint)
        config, record, version = read_checkpoint_metadata(path)
        said = version[:60] if version.isprintable() else ascii(version[:60])
        print(f'file:    {path}\nsize:    {path.stat().st_size} bytes\nversion: {said}')
        for title, content in (('policy', config.to_dict()), ('record', record)):
            try:
                text = json.dumps(content, indent=2)
            except RecursionError:
                raise UserError(f'{path}: its {title} is nested too deep to be shown') from None
            print(f'{title}:\n{text}')
        if self.weights:
            for name, value in load_policy(self.checkpoint).state_dict().items():
                print(f'{name:24} {tuple(value.shape)}')
        return 0


@dataclass
class _Card:
    """Print the model card of a checkpoint, in Markdown."""

    checkpoint: CheckpointName
    """A file, or the name of a shipped one."""

    def run(self) -> int:
        """Print it."""
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

    def run(self) -> int:
        """Write it."""
        from shepherd_ros.policy.checkpoint import CHECKPOINT_SUFFIX, save_policy
        from shepherd_ros.policy.policy import Policy, PolicyConfig
        import torch

        if self.output.suffix != CHECKPOINT_SUFFIX:
            raise UserError(
                f'--output is {self.output}: expected a name that ends in {CHECKPOINT_SUFFIX}'
            )
        made_folder('--output', self.output.parent)
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

    def run(self) -> int:
        """Write it."""
        from shepherd_ros.policy.checkpoint import load_policy
        from shepherd_ros.policy.torchscript import export_actor

        made_folder('--output', self.output.parent)
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
