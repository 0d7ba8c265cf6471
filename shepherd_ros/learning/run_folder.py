"""Folder of a training run: its configuration, its curve, its state and its best policy."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
import fcntl
import io
import json
import math
import os
from pathlib import Path
import pickle
from typing import Any

from shepherd_ros.config import Config, ConfigError
from shepherd_ros.learning.distributed import broadcast, gather, rank, ranks
from shepherd_ros.learning.durable_files import replace_file, writing
from shepherd_ros.learning.trainer import Trainer
from shepherd_ros.policy.checkpoint import read_checkpoint_metadata, save_policy
from shepherd_ros.policy.policy import Policy
import torch

# what torch raises for bytes that are no state, and what a state of another run leads to
STATE_ERRORS = (
    AttributeError, EOFError, LookupError, OSError, pickle.UnpicklingError, RuntimeError,
    TypeError, ValueError,
)  # fmt: skip
LENGTHS = ('samples', 'rounds', 'epochs')  # options that a run may be given more of


def is_same(requested: Any, stored: Any) -> bool:
    """Return whether a stored part of a configuration is the requested one, or a shorter run."""
    if not isinstance(requested, Config):
        return bool(requested == stored)
    longer = {
        name: getattr(requested, name)
        for name in LENGTHS
        if isinstance(stored, Mapping) and 0 < stored.get(name, 0) <= getattr(requested, name, 0)
    }
    return requested.equals({**stored, **longer} if longer else stored)


class RunFolder:
    """
    A folder with run.json (configuration), curve.jsonl, state.pt and best.safetensors.

    It belongs to one process, which locks it; of several, to the first. TensorBoard reads its
    curves from the same folder.
    """

    def __init__(self, folder: Path, record: Mapping[str, Any]) -> None:
        """Create the folder, or open its run; record is plain data but for parts of its config."""
        requested = record['config']
        config = {
            name: value.to_dict() if isinstance(value, Config) else value
            for name, value in requested.items()
        }
        self.folder, self.record = folder, {**record, 'config': config}
        self.best, self.best_score = folder / 'best.safetensors', -math.inf
        self.state, self.curve = folder / 'state.pt', folder / 'curve.jsonl'
        self.seconds = 0.0  # that it took
        self._board: Any = None
        run_file = folder / 'run.json'
        self.resumes = run_file.exists()
        if rank() > 0:
            return
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        stored = self._stored(run_file) if self.resumes else {}
        if self.resumes and not (
            stored.keys() == requested.keys()
            and all(is_same(value, stored[name]) for name, value in requested.items())
        ):
            raise ConfigError(
                f'{folder} holds a run with another configuration: expected the same, or more '
                'samples, rounds or epochs, to go on with it; choose another --out, or remove '
                'the folder'
            )
        self._lock()
        try:
            self._begin(run_file, is_new=stored != config)
        except ConfigError:
            self.close()
            raise

    def _begin(self, run_file: Path, is_new: bool) -> None:
        """Write a new configuration, and read the score of the best policy so far."""
        if is_new:
            text = json.dumps(self.record, indent=1)
            replace_file(run_file, lambda file: file.write(text.encode()))
        if self.best.exists():
            score = read_checkpoint_metadata(self.best)[1].get('eval', {}).get('score', -math.inf)
            self.best_score = score if math.isfinite(score) else -math.inf

    def _stored(self, path: Path) -> dict[str, Any]:
        """Return the configuration of the stored run."""
        try:
            return dict(json.loads(path.read_text(encoding='utf-8'))['config'])
        except STATE_ERRORS as error:
            raise ConfigError(
                f'{path} cannot be read ({error!s:.200}): expected that of a run; choose another '
                '--out, or remove the folder'
            ) from error

    def _lock(self) -> None:
        """Lock the folder until close(), or until the process ends."""
        with writing(self.folder):
            self.lock = (self.folder / 'lock').open('w')
        try:
            fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ConfigError(
                f'{self.folder} is in use: expected one training at a time; wait until the other '
                'is over, or choose another --out'
            ) from None

    def close(self) -> None:
        """Release the lock of the folder."""
        if rank() == 0:
            self.lock.close()

    def load(self, trainer: Trainer) -> dict[str, Any] | None:
        """Restore the last saved state; return the line that the curve lacks, or None."""
        saved: Any = None
        try:
            if rank() == 0 and self.state.exists():
                saved = torch.load(self.state, weights_only=True, map_location='cpu')
            saved = broadcast(saved)
            if saved is None:
                self.curve.unlink(missing_ok=True)
                return None
            states, line, self.seconds = saved['ranks'], saved['line'], saved['seconds']
            if len(states) != ranks():
                raise ConfigError(f'{len(states)} processes, expected {ranks()}, as now')
            trainer.load_state_dict(states[rank()])
        except STATE_ERRORS as error:
            raise ConfigError(
                f'{self.state} cannot be read as a state of this run on this device '
                f'({error!s:.200}): remove it to start anew'
            ) from error
        return self._cut(trainer.progress['updates'], line) if rank() == 0 else None

    def _cut(self, updates: int, line: dict[str, Any] | None) -> dict[str, Any] | None:
        """Cut the curve to a number of updates; return the line if the curve lacks it."""
        lines: list[str] = []
        with suppress(FileNotFoundError):
            lines = self.curve.read_text(encoding='utf-8').splitlines(keepends=True)
        whole = [text for text in lines[:updates] if text.endswith('\n')]
        if len(whole) < updates - (line is not None):
            raise ConfigError(
                f'{self.curve} has {len(whole)} lines: expected {updates}, as {self.state.name} '
                f'is of that update; remove {self.state} to start anew'
            )
        if whole != lines:  # what comes later is written again; the last one may be torn
            replace_file(self.curve, lambda file: file.write(''.join(whole).encode()))
        return None if len(whole) == updates else line

    def save(self, trainer: Trainer, line: dict[str, Any] | None) -> None:
        """Write the state of all processes, with the line that the curve still lacks."""
        states = [trainer.state_dict()]
        if ranks() > 1:
            buffer = io.BytesIO()
            torch.save(states[0], buffer)
            parts = [io.BytesIO(part) for part in gather(buffer.getvalue())]
            states = [torch.load(part, weights_only=True, map_location='cpu') for part in parts]
        if rank() == 0:
            state = {'ranks': states, 'line': line, 'seconds': self.seconds}
            replace_file(self.state, lambda file: torch.save(state, file))

    def keep_best(
        self, policy: Policy, results: Mapping[str, float], progress: Mapping[str, Any]
    ) -> dict[str, float]:
        """Keep a policy if its score is the best so far; return the results as part of a line."""
        if results['score'] > self.best_score:
            self.best_score = results['score']
            self._save(self.best, policy, results, progress)
        return {f'eval/{name}': value for name, value in results.items()}

    def keep_evaluated(
        self, policy: Policy, results: Mapping[str, float], progress: Mapping[str, Any]
    ) -> None:
        """Keep a policy as evaluated/UPDATES.safetensors, whatever its score."""
        path = self.folder / 'evaluated' / f'{int(progress["updates"]):06d}.safetensors'
        with writing(path):
            path.parent.mkdir(exist_ok=True)
        self._save(path, policy, results, progress)

    def _save(
        self,
        path: Path,
        policy: Policy,
        results: Mapping[str, float],
        progress: Mapping[str, Any],
    ) -> None:
        """Write a policy with its results and the progress of the run."""
        results_record = {'progress': dict(progress), 'eval': dict(results)}
        with writing(path):
            save_policy(path, policy, self.record | results_record)

    def write(self, line: Mapping[str, Any]) -> None:
        """Add a line to the curve, and its numbers to TensorBoard."""
        numbers = {name: value for name, value in line.items() if isinstance(value, float)}
        not_finite = {name: None for name, value in numbers.items() if not math.isfinite(value)}
        with writing(self.curve):
            with self.curve.open('a', encoding='utf-8') as file:
                file.write(json.dumps({**line, **not_finite}) + '\n')
                file.flush()
                os.fsync(file.fileno())
            if self._board is None:
                from torch.utils.tensorboard import SummaryWriter

                self._board = SummaryWriter(str(self.folder), purge_step=int(line['samples']))
            for name, value in numbers.items():
                self._board.add_scalar(name, value, int(line['samples']))
            self._board.flush()
