"""Folder of a training run: its configuration, its curve, its state and its best policy."""

from __future__ import annotations

from collections.abc import Mapping
import json
import math
from pathlib import Path
import pickle
from typing import Any

from shepherd_ros.config import Config, ConfigError
from shepherd_ros.learning.distributed import rank
from shepherd_ros.policy.checkpoint import save_policy
from shepherd_ros.policy.policy import Policy
import torch

# what torch raises for bytes that are no state
UNREADABLE = (
    AttributeError, EOFError, LookupError, OSError, pickle.UnpicklingError, RuntimeError,
    TypeError, ValueError,
)  # fmt: skip


class RunFolder:
    """
    A folder with run.json (what was asked), curve.jsonl, state.pt and best.safetensors.

    TensorBoard reads its curves from the same folder.
    """

    def __init__(self, folder: Path, record: Mapping[str, Any]) -> None:
        """Make the folder, or find its run; record is plain data but for parts of its config."""
        asked_for = record['config']
        config = {
            name: value.to_dict() if isinstance(value, Config) else value
            for name, value in asked_for.items()
        }
        self.folder, self.record = folder, {**record, 'config': config}
        self.best = folder / 'best.safetensors'
        self.best_score = -math.inf
        self.state = folder / (f'state_{rank()}.pt' if rank() else 'state.pt')
        asked = folder / 'run.json'
        folder.mkdir(parents=True, exist_ok=True)
        if asked.exists():
            before = json.loads(asked.read_text(encoding='utf-8'))['config']
            if before.keys() != asked_for.keys() or not all(
                value.equals(before[name]) if isinstance(value, Config) else value == before[name]
                for name, value in asked_for.items()
            ):
                raise ConfigError(
                    f'{folder} holds a run with another configuration: expected the same to go '
                    'on with it; choose another --out, or remove the folder'
                )
        elif rank() == 0:
            asked.write_text(json.dumps(self.record, indent=1), encoding='utf-8')
        self._board: Any = None

    def load(self) -> dict[str, Any] | None:
        """Return the state that was saved last, cut the curve back to it; None: there is none."""
        curve = self.folder / 'curve.jsonl'
        if not self.state.exists():
            if rank() == 0:
                curve.unlink(missing_ok=True)
            return None
        try:
            state = torch.load(self.state, weights_only=True, map_location='cpu')
        except UNREADABLE as error:
            raise ConfigError(
                f'{self.state} cannot be read ({error}): remove it to start anew'
            ) from error
        if rank() > 0:
            return dict(state)
        lines = curve.read_text(encoding='utf-8').splitlines(keepends=True)
        # later lines are written again; the last one may be torn
        curve.write_text(''.join(lines[: state['progress']['updates']]), encoding='utf-8')
        return dict(state)

    def save(self, state: Mapping[str, Any]) -> None:
        """Write a state; the one before stays until the new one is whole."""
        beside = self.state.with_suffix('.part')
        torch.save(dict(state), beside)
        beside.replace(self.state)

    def keep_best(
        self, policy: Policy, results: Mapping[str, float], progress: Mapping[str, Any]
    ) -> dict[str, float]:
        """Keep a policy if its score is the best so far; return the results as part of a line."""
        if results['score'] > self.best_score:
            self.best_score = results['score']
            save_policy(
                self.best,
                policy,
                self.record | {'progress': dict(progress), 'eval': dict(results)},
            )
        return {f'eval/{name}': value for name, value in results.items()}

    def write(self, line: Mapping[str, Any]) -> None:
        """Add a line to the curve, and its numbers to TensorBoard."""
        with (self.folder / 'curve.jsonl').open('a', encoding='utf-8') as file:
            file.write(json.dumps(dict(line)) + '\n')
        if self._board is None:
            from torch.utils.tensorboard import SummaryWriter

            self._board = SummaryWriter(str(self.folder), purge_step=int(line['samples']))
        for name, value in line.items():
            if isinstance(value, float):
                self._board.add_scalar(name, value, int(line['samples']))
        self._board.flush()
