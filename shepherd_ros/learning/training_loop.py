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


class TrainingLoop:
    """The loop of a trainer, until all is done, with the folder of its run."""

    def __init__(
        self, run: RunFolder, trainer: Trainer, on_line: Callable[[dict[str, Any]], None]
    ) -> None:
        """Use a trainer and the folder of its run; on_line(line) gets each line of the curve."""
        self.run, self.trainer, self.on_line = run, trainer, on_line
        self.signal, self.saved = 0, False

    def run_to_end(self) -> None:
        """Resume the run, and train until all is done."""
        run, trainer = self.run, self.trainer
        with self._signals():
            line = run.load(trainer)
            if line is not None:
                self._finish(line)
            started = time.monotonic() - run.seconds
            while trainer.share() < 1:
                scalars = trainer.update(self.stopping)
                run.seconds = time.monotonic() - started
                line, stop = None, self.stopping()
                if scalars is not None:
                    self._require_finite(scalars)
                    line = self._line(scalars)
                if stop or self._evaluation_due():
                    run.save(trainer, line)
                if stop:
                    self._exit()
                if line is not None and rank() == 0:
                    self._finish(line)
                    run.seconds = time.monotonic() - started

    def _line(self, scalars: Mapping[str, float]) -> dict[str, Any]:
        """Return the line of an update."""
        progress, seconds = self.trainer.progress, self.run.seconds
        return {
            **progress,
            'seconds': seconds,
            'samples_per_second': progress['samples'] / seconds,
            'seconds_left': seconds * max(1 / self.trainer.share() - 1, 0),
            **scalars,
        }

    def stopping(self) -> bool:
        """Return whether any process got a stop signal; a collective call of all processes."""
        return total(float(self.signal > 0)) > 0

    def _evaluation_due(self) -> bool:
        """Return whether the policy is evaluated after this update."""
        done = self.trainer.progress['updates']
        return self.trainer.share() >= 1 or done % self.trainer.eval_freq == 0

    def _finish(self, line: dict[str, Any]) -> None:
        """Evaluate where it is due, and write the line."""
        if self._evaluation_due():
            self.saved, config, policy = True, self.trainer.config, self.trainer.averaged()
            if self.signal:
                self._exit()
            results = self.trainer.evaluate(policy)
            self.saved = False
            line |= self.run.keep_best(policy, results, line)
            if config.evaluation.keep_evaluated:
                self.run.keep_evaluated(policy, results, line)
        self.run.write(line)
        self.on_line(line)

    def _require_finite(self, scalars: Mapping[str, float]) -> None:
        """Raise ConfigError for scalars or weights that are not finite."""
        not_finite = [name for name, value in scalars.items() if not math.isfinite(value)]
        weights = self.trainer.policy.state_dict().items()
        not_finite += [name for name, weight in weights if not weight.isfinite().all()]
        if not_finite:
            raise ConfigError(
                f'{not_finite[0]} is not finite after update {self.trainer.progress["updates"]}: '
                f'expected numbers; lower the learning rates; {self.run.folder} keeps what was '
                'before'
            )

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """Handle SIGINT and SIGTERM: the first one ends the training after a saved state."""

        def on_signal(number: int, frame: Any) -> None:
            repeated, self.signal = self.signal > 0, number
            if repeated or self.saved:
                self._exit()

        in_main_thread = threading.current_thread() is threading.main_thread()
        numbers = (signal.SIGINT, signal.SIGTERM) if in_main_thread else ()
        handled = [n for n in numbers if signal.getsignal(n) is not signal.SIG_IGN]
        old_handlers = {number: signal.signal(number, on_signal) for number in handled}
        try:
            yield
        except RuntimeError:  # others have left while this process waited for them
            if not self.signal:
                raise
            self._exit()
        finally:
            for number, handler in old_handlers.items():
                signal.signal(number, handler)
            self.run.close()

    def _exit(self) -> None:
        """Raise the exception that belongs to the signal."""
        if self.signal == signal.SIGINT:
            raise KeyboardInterrupt
        raise SystemExit(128 + (self.signal or signal.SIGTERM))
