"""Comparison of a controller's commands on recorded states with the recorded ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from shepherd_ros.controllers.controller import Controller, Memory
from shepherd_ros.recordings.episodes import Frame, RecordedEpisode
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.state import WorldState
from shepherd_ros.wire.decode import Floats
from torch import Tensor

CommandsByShepherd = Mapping[int, Floats]  # by shepherd (2,) m/s


def frames_to_check(episode: RecordedEpisode) -> list[Frame]:
    """Return the states to compare; in real time only those with a recorded command."""
    if episode.mode != 'realtime':
        return episode.frames
    return [f for f in episode.frames if any(c is not None for c in f.commands)]


def law_commands(
    states: WorldState, controller: Controller, noise_std: float
) -> Iterator[tuple[Memory, Tensor]]:
    """
    Yield the memory before each of the states (T) in a row, and the law's command (H, 2) m/s.

    The memory is that of a batch of one world; the controller begins at the first state.
    """
    memory: Memory | None = None
    for t in range(len(states.step)):
        perceived = perceive(states.world(slice(t, t + 1)), noise_std)
        before = controller.begin(perceived) if memory is None else memory
        command, memory = controller.act(perceived, before)
        yield before, command[0]


@dataclass
class Comparison:
    """Comparison of commands with the recorded ones [m/s]; a difference is a Euclidean norm."""

    tolerance: float = 0.0  # [m/s]
    shepherds: tuple[int, ...] = ()  # those that count, all if empty
    episodes: int = 0
    compared: int = 0
    equal: int = 0
    n_beyond: int = 0  # differ by more than the tolerance
    max_difference: float = 0.0  # [m/s]
    sum_of_differences: float = 0.0  # [m/s]
    first: str = ''  # difference beyond the tolerance
    missing: int = 0
    first_missing: str = ''
    skipped: int = 0  # states that are not in the recording, or that nobody answered then

    @property
    def ok(self) -> bool:
        """Return whether commands were compared and all are within the tolerance."""
        return self.compared > 0 and not self.n_beyond and not self.missing

    def add_episode(self, episode: RecordedEpisode, frames: Sequence[Frame]) -> None:
        """Count an episode and its states that are not among the compared frames."""
        self.episodes += 1
        last = frames[-1].step if frames else episode.episode_steps
        self.skipped += last + 1 - len(frames)

    def add(self, episode: RecordedEpisode, frame: Frame, answers: CommandsByShepherd) -> None:
        """Compare the recorded commands of a state with those of now, (2,) m/s by shepherd."""
        final = frame is episode.frames[-1]  # a recording may end before the last answers
        for h, recorded in enumerate(frame.commands):
            answer = answers.get(h)
            if self.shepherds and h not in self.shepherds:
                continue
            if recorded is None and (final or answer is None):
                continue
            place = (
                f'episode {episode.number}, step {frame.step}, '
                f'stamp {frame.stamp_ns * 1e-9:.9f} s, shepherd_{h}'
            )
            if recorded is None or answer is None:
                self.missing += 1
                side = 'in the recording' if recorded is None else 'from the controller'
                self.first_missing = self.first_missing or f'{place}: no command {side}'
                continue
            difference = _difference(recorded, answer)
            self.compared += 1
            self.equal += difference == 0
            self.max_difference = max(self.max_difference, difference)
            self.sum_of_differences += difference
            if difference > self.tolerance:
                self.n_beyond += 1
                self.first = self.first or f'{place}: {_pair(recorded)}, now {_pair(answer)} m/s'

    def text(self) -> str:
        """Return the comparison in lines for a terminal."""
        mean = self.sum_of_differences / max(self.compared, 1)
        lines = [
            f'{self.compared} commands of {self.episodes} episodes compared: {self.equal} equal, '
            f'{self.n_beyond} differ by more than {self.tolerance:g} m/s',
            f'difference: {self.max_difference:.6g} m/s at most, {mean:.6g} m/s on average',
        ]
        if self.first:
            lines.append(f'first difference: {self.first}')
        if self.missing:
            lines.append(f'missing: {self.missing} commands; {self.first_missing}')
        if self.skipped:
            lines.append(
                f'not asked: {self.skipped} states that were not recorded or not answered; what '
                'the controller remembers may differ'
            )
        if not self.compared:
            lines.append('nothing to compare: expected a recording with commands')
        return '\n'.join([*lines, 'equal' if self.ok else 'different'])


def _difference(recorded: Floats, answer: Floats) -> float:
    """Return |recorded - answer| [m/s]; NaN equals NaN, else it is infinitely far."""
    if np.array_equal(recorded, answer, equal_nan=True):
        return 0.0
    difference = float(np.linalg.norm(recorded - answer))
    return difference if np.isfinite(difference) else float('inf')


def _pair(velocity: Floats) -> str:
    """Return a velocity with all its digits."""
    return f'({velocity[0]:.9g}, {velocity[1]:.9g})'
