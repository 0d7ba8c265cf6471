"""
The loop of a training: update, save, evaluate, write; it ends early by SIGTERM and Ctrl-C.

A state is saved before each evaluation, and after a signal when the running update is over.
Whenever a run ends, the same command goes on with the same numbers as if it had not ended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
import math
import signal
import threading
import time
from typing import Any

from shepherd_ros.config import ConfigError
from shepherd_ros.learning.distributed import rank, total
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.trainer import Trainer
from shepherd_ros.learning.validation import validate


class TrainingLoop:
    """A trainer that learns until all is done, and the folder of its run."""

    def __init__(
        self, run: RunFolder, trainer: Trainer, on_line: Callable[[dict[str, Any]], None]
    ) -> None:
        """Take what learns and where it is kept; on_line hears each line of the curve."""
        self.run, self.trainer, self.on_line = run, trainer, on_line
        self.signal, self.saved = 0, False

    def go_on(self) -> None:
        """Go on where the run is, until all is done."""
        run, trainer = self.run, self.trainer
        with self._signals():
            line = run.load(trainer)
            if line is not None:
                self._finish(line)
            begun = time.monotonic() - run.seconds
            while trainer.share() < 1:
                seen = trainer.update(self.stopping)
                run.seconds = time.monotonic() - begun
                line, stop = None, self.stopping()
                if seen is not None:
                    self._require_finite(seen)
                    line = self._line(seen)
                if stop or self._due():
                    run.save(trainer, line)
                if stop:
                    self._leave()
                if line is not None and rank() == 0:
                    self._finish(line)
                    run.seconds = time.monotonic() - begun

    def _line(self, seen: Mapping[str, float]) -> dict[str, Any]:
        """Return the line of an update."""
        progress, seconds = self.trainer.progress, self.run.seconds
        return {
            **progress,
            'seconds': seconds,
            'samples_per_second': progress['samples'] / seconds,
            'seconds_left': seconds * max(1 / self.trainer.share() - 1, 0),
            **seen,
        }

    def stopping(self) -> bool:
        """Return whether a process was told to end; all processes ask at the same places."""
        return total(float(self.signal > 0)) > 0

    def _due(self) -> bool:
        """Return whether the policy is evaluated after this update."""
        done = self.trainer.progress['updates']
        return self.trainer.share() >= 1 or done % self.trainer.eval_freq == 0

    def _finish(self, line: dict[str, Any]) -> None:
        """Evaluate where it is due, and write the line."""
        if self._due():
            self.saved, config, policy = True, self.trainer.config, self.trainer.averaged()
            if self.signal:
                self._leave()
            results = validate(
                policy, config.task, config.eval_episodes, config.eval_steps, self.trainer.dtype
            )
            self.saved = False
            line |= self.run.keep_best(policy, results, line)
        self.run.write(line)
        self.on_line(line)

    def _require_finite(self, seen: Mapping[str, float]) -> None:
        """Raise ConfigError for a learner that is broken; nothing of it is kept."""
        wrong = [name for name, value in seen.items() if not math.isfinite(value)]
        weights = self.trainer.policy.state_dict().items()
        wrong += [name for name, weight in weights if not weight.isfinite().all()]
        if wrong:
            raise ConfigError(
                f'{wrong[0]} is not finite after update {self.trainer.progress["updates"]}: '
                f'expected numbers; lower the learning rates; {self.run.folder} keeps what was '
                'before'
            )

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """Hear SIGINT and SIGTERM: the first waits for a state that can be saved."""

        def hear(number: int, frame: Any) -> None:
            again, self.signal = self.signal > 0, number
            if again or self.saved:
                self._leave()

        there = threading.current_thread() is threading.main_thread()
        numbers = (signal.SIGINT, signal.SIGTERM) if there else ()
        heard = [n for n in numbers if signal.getsignal(n) is not signal.SIG_IGN]
        before = {number: signal.signal(number, hear) for number in heard}
        try:
            yield
        except RuntimeError:  # others have left while this process waited for them
            if not self.signal:
                raise
            self._leave()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
            self.run.close()

    def _leave(self) -> None:
        """End as the signal asks for."""
        if self.signal == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + (self.signal or signal.SIGTERM))
