"""The node of a learned policy: scans in, velocities out."""

from __future__ import annotations

from collections import deque
from time import perf_counter
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers.policy_controller import LearnedConfig, require_task, sample_noise
from shepherd_ros.nodes.mux_parameters import declare_source
from shepherd_ros.policy import inference
from shepherd_ros.policy.checkpoint import load_policy
from shepherd_ros.policy.inference import PolicyMemory
from shepherd_ros.ros.episode_subscriber import listen_to_episodes
from shepherd_ros.ros.intra_process import Output
from shepherd_ros.ros.node import ERROR, OK, ShepherdNode, WARN
from shepherd_ros.ros.parameters import declare_config
from shepherd_ros.ros.runtime import run
from shepherd_ros.ros.scan_subscriber import SCAN_WARNING_PERIOD, ScanListener
from shepherd_ros.ros.world_subscriber import episode_and_world, LOCKSTEP_SILENCE_TIMEOUT
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.encode import encode_command, encode_twist
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import command_type
import torch
from torch import Tensor

_ALL = -1  # in shepherd_ids
LATENCY_WINDOW = 1000  # last answers whose latency is kept
CHANNEL_CHECK_DELAY = 1.0  # [s] without a complete scan until the publishers are checked


class PolicyNode(ShepherdNode):
    """Publishes a velocity for each of its shepherds from their scans, all in one batch."""

    def __init__(self, **kwargs: Any) -> None:
        """Load the checkpoint and subscribe to the episode."""
        super().__init__('policy', **kwargs)
        torch.set_num_threads(1)
        self.options = declare_config(self, LearnedConfig())
        self.shepherd_ids: list[int] = self.option(
            'shepherd_ids', [_ALL], 'shepherds to command, each by its own scans; [-1]: all'
        )
        ids = self.shepherd_ids
        if ids != [_ALL] and (min(ids) < 0 or len(set(ids)) < len(ids)):
            raise ConfigError(
                f'shepherd_ids is {ids}: expected each shepherd once, counted from 0, such as '
                '[0, 1, 2], or [-1] for all'
            )
        self.commands = declare_source(self)
        self.stamped: bool = self.option(
            'stamped', True, 'publish TwistStamped; false: Twist, which has no stamp'
        )
        self.stale_after: float = self.option(
            'stale_after',
            1.0,
            'realtime: without scans for so long [s], wall time, zero is commanded',
            low=0.0,
        )
        self.policy = load_policy(self.options.checkpoint)
        self.std = self.options.std_of(self.policy.config)
        self.timing = self.policy.config.timing(WorldConfig().dt)  # until an episode begins
        self.deviation = ''  # of the last episode
        self.episode: Episode | None = None
        self.max_speed = 0.0  # [m/s]
        self.present: list[int] = []
        self.refusal = ''  # why an episode is not driven
        self.silent: list[str] = []  # scans that no lidar publishes
        self.memory: PolicyMemory = {}
        self.last_ranges = torch.empty(0)  # last ranges (H, C, R) m of those present
        self.last: tuple[int, Tensor] | None = None
        self.last_scan_time = self.wall()
        self.stale = False
        self.missing_scans: list[str] = []  # scans that do not come, and who publishes them
        self.answers = 0
        self.latency: deque[float] = deque(maxlen=LATENCY_WINDOW)  # [s]
        self.outputs: dict[int, Output] = {}
        self.scans = ScanListener(self, self.policy.config.lidar, self.on_scans)
        self._warm_up()
        listen_to_episodes(self, episode_and_world, self._begin)
        self.timer(0.1, self._check_scans)

    def _warm_up(self) -> None:
        """Run inference once, as its first call takes most of a second."""
        team = len(self.shepherd_ids)  # another team's first answer takes no longer
        ranges = torch.full((team, *self.policy.config.lidar.layout.shape), torch.inf)
        ranges[..., ::2] = 5.0
        has_scan = torch.ones(team, dtype=torch.bool)
        memory = inference.begin(self.policy, self.timing, (), team)
        inference.act(self.policy, self.timing, lambda: ranges, has_scan, memory, 1.0)

    def _begin(self, content: tuple[Episode, WorldConfig]) -> None:
        """Start an episode with an empty memory, or refuse it."""
        episode, world = content
        self.episode, self.max_speed = episode, world.shepherd_speed
        self.last, self.timing = None, self.policy.config.timing(world.dt)
        team = range(episode.n_shepherds) if self.shepherd_ids == [_ALL] else self.shepherd_ids
        self.present = [h for h in team if h < episode.n_shepherds]
        unknown = sorted(set(team) - set(self.present))
        if unknown:
            self.get_logger().error(
                f'shepherd_ids has {unknown}: expected 0 to {episode.n_shepherds - 1}, as this '
                'episode has no others; they get no commands'
            )
        self.refusal = ''
        try:
            require_task(self.policy, world)
        except ConfigError as error:
            self.refusal, self.present = str(error), []
            self.get_logger().error(f'this episode is not driven: {error}')
        if self.timing.deviation not in ('', self.deviation):
            self.get_logger().warning(f'{self.options.checkpoint} {self.timing.deviation}')
        self.deviation = self.timing.deviation
        for h in [h for h in self.outputs if h not in self.present]:
            self.destroy_publisher(self.outputs.pop(h))
        kind = command_type(self.stamped)
        for h in [h for h in self.present if h not in self.outputs]:
            self.outputs[h] = self.advertise(self.commands, h, kind)
        self.scans.listen_to(self.present)

    def on_scans(self, ns: int, ranges: dict[int, np.ndarray]) -> None:
        """Publish the commands for the scans of a stamp; the same again for a repeated stamp."""
        started, self.last_scan_time, self.stale, self.missing_scans = (
            perf_counter(),
            self.wall(),
            False,
            [],
        )
        episode = self.episode
        if episode is None or not episode.has(ns):
            return
        if self.last is None or ns != self.last[0]:
            skipped = 0
            if self.last is not None and ns > self.last[0]:
                skipped = episode.step_of(ns) - episode.step_of(self.last[0]) - 1
            else:
                self.memory = inference.begin(self.policy, self.timing, (), len(self.present))
                shape = (len(self.present), *self.policy.config.lidar.layout.shape)
                self.last_ranges = torch.full(shape, torch.inf)
            self.last = (ns, self._decide(ns, ranges, episode, skipped))
        self._publish(*self.last)
        self.answers += 1
        self.latency.append(perf_counter() - started)

    def _decide(
        self, ns: int, ranges: dict[int, np.ndarray], episode: Episode, skipped: int
    ) -> Tensor:
        """Return velocities (H, 2) m/s, zero for shepherds without all of their scans."""
        has_scan = torch.tensor([h in ranges for h in self.present])
        newest = self.last_ranges.clone()  # what was seen before stands in for what is missing
        for i, h in enumerate(self.present):
            if h in ranges:
                newest[i] = torch.from_numpy(ranges[h])

        def draws() -> Tensor:
            seed, step = torch.tensor(episode.seed), torch.tensor(episode.step_of(ns))
            return sample_noise(seed, step, episode.n_shepherds)[self.present]

        self.last_ranges = newest
        command, self.memory = inference.act(
            self.policy,
            self.timing,
            lambda: newest,
            torch.ones_like(has_scan),
            self.memory,
            self.max_speed,
            None if self.std is None else draws,
            skipped,
            self.std or 0.0,
        )
        return torch.where(has_scan[:, None], command, 0.0)

    def _publish(self, ns: int, command: Tensor) -> None:
        for h, (x, y) in zip(self.present, command.tolist(), strict=True):
            stamped = encode_command(ns, self.frame_id, x, y)
            self.outputs[h].publish(stamped if self.stamped else encode_twist(x, y))

    def _check_scans(self) -> None:
        """Log channels without publisher; in real time, stop the shepherds without scans."""
        silent = self.wall() - self.last_scan_time > CHANNEL_CHECK_DELAY
        self.silent = self.scans.unpublished() if silent else []
        if self.silent:
            self.get_logger().error(
                f'no lidar publishes {", ".join(self.silent)}, which the checkpoint needs: start '
                'it with the option others, or choose another checkpoint',
                throttle_duration_sec=SCAN_WARNING_PERIOD,
            )
        episode, last = self.episode, self.last
        if episode is None:
            return
        self._report_missing()
        if episode.mode == 'lockstep' or last is None or self.stale:
            return
        if self.wall() - self.last_scan_time > self.stale_after:
            self.stale = True
            self.get_logger().warning(
                f'no scans for {self.stale_after} s: commanding zero until they come again'
            )
            self._publish(last[0], torch.zeros_like(last[1]))

    def _report_missing(self) -> None:
        """Log the missing scans with their publishers, again if that changes."""
        if self.wall() - self.last_scan_time < max(self.stale_after, LOCKSTEP_SILENCE_TIMEOUT):
            return
        missing = [self.sourced(name) for name in self.scans.missing_scans()]
        if missing != self.missing_scans:
            self.missing_scans = missing
            self.get_logger().warning(f'waiting for {", ".join(missing)}: no scans come')

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return the status of the policy: activity, latency and faults of scans."""
        level, message = OK, 'commanding'
        if self.refusal:
            level, message = ERROR, f'checkpoint does not fit: {self.refusal}'
        elif self.silent:
            level, message = ERROR, f'no lidar publishes {", ".join(self.silent)}'
        elif self.stale:
            level, message = WARN, 'scans have stopped: commanding zero'
        elif self.missing_scans:
            level, message = WARN, f'waiting for {", ".join(self.missing_scans)}'
        elif self.last is None:
            level, message = WARN, 'no scans heard yet'
        elif self.scans.faults:
            level, message = WARN, 'some scans were missing or not fit to use'
        times = sorted(self.latency) or [0.0]
        return [
            self.status(
                'policy',
                level,
                message,
                checkpoint=self.options.checkpoint,
                answers=self.answers,
                shepherds=self.present,
                decision_interval=round(self.timing.decision_interval, 6),
                latency_ms_median=round(1e3 * times[len(times) // 2], 3),
                latency_ms_p99=round(1e3 * times[int(0.99 * (len(times) - 1))], 3),
                **{f'scans_{kind}': count for kind, count in self.scans.faults.items()},
            )
        ]


def main() -> int:
    """Run a learned policy for all shepherds of the episode, or for some by shepherd_ids."""
    return run(PolicyNode, 'policy', main.__doc__ or '')
