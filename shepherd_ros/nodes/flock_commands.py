"""Commands of the shepherds to flock_sim: accepted, refused and missing ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import NodeNameNonExistentError
from shepherd_ros.nodes.command_writers import CommandWriters
from shepherd_ros.nodes.pending_commands import CommandBuffer
from shepherd_ros.ros.node import ERROR, OK, ShepherdNode, UNKNOWN_NODE_NAME, WARN
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.sim.limits import MAX_FLOAT32
from shepherd_ros.wire.decode import decode_stamp, Vector
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import command_type, COMMANDS, scan_topic

REFUSAL_WARNING_PERIOD = 5.0  # [s] between two warnings of one kind
SILENCE_CHECK_PERIOD = 0.5  # [s] between two checks of the reason for missing commands


def seconds_text(ns: int) -> str:
    """Return nanoseconds as seconds with all digits: stamps may differ in the last one."""
    return f'{ns // 10**9}.{ns % 10**9:09d}'


class FlockCommands:
    """
    Subscribes to the commands of every shepherd of an episode; on_answers() once all are there.

    In lockstep a stamped command counts if its stamp is that of the present state; in realtime
    if it is at most watchdog_steps old. Every refusal is counted for /diagnostics and logged.
    """

    def __init__(self, node: ShepherdNode, on_answers: Callable[[], None]) -> None:
        """Declare the parameters; begin() subscribes."""
        self.node, self.on_answers = node, on_answers
        self.stamped: bool = node.option(
            'stamped', True, 'commands are TwistStamped; false: Twist, taken for the present state'
        )
        self.kind = command_type(self.stamped)
        self.writers = CommandWriters(node, self.kind)
        self.watchdog_steps: int = node.option(
            'watchdog_steps',
            3,
            'realtime: a shepherd silent for more steps than this stops',
            low=0,
        )
        self.wait_for_scans: bool = node.option(
            'wait_for_scans', False, 'lockstep: also wait until every shepherd has been scanned'
        )
        self.commands = CommandBuffer(0)
        self.inputs: list[Any] = []
        self.scans: dict[str, Any] = {}
        self.scanned: set[str] = set()
        self.counts: Counter[str] = Counter()
        self.last_logged: dict[str, float] = {}
        self.lockstep = True
        self.now_ns = self.dt_ns = 0
        self.waiting_since = node.wall()
        self.reasons: dict[str, str] = {}  # the reason, by silent topic
        self.next_check = 0.0  # when to look for the reason again
        self.reported_refusals = 0  # commands that were not finite, at the last report

    def begin(self, episode: Episode) -> None:
        """Subscribe to the commands of the team of an episode."""
        self.lockstep = episode.mode == 'lockstep'
        self.commands = CommandBuffer(episode.n_shepherds)
        self.reasons = {}
        while len(self.inputs) > episode.n_shepherds:
            self.node.destroy_subscription(self.inputs.pop())
        for h in range(len(self.inputs), episode.n_shepherds):
            self.inputs.append(self.node.listen(COMMANDS, self._receiver(h), h, kind=self.kind))
        scans = {
            scan_topic(channel).format(h=h): (scan_topic(channel), h)
            for h in range(episode.n_shepherds if self.wait_for_scans else 0)
            for channel in PAPER_CHANNELS
        }
        for name in self.scans.keys() - scans.keys():
            self.node.destroy_subscription(self.scans.pop(name))
        for name in [name for name in scans if name not in self.scans]:
            topic, h = scans[name]
            receiver = self._scan_receiver(name)
            self.scans[name] = self.node.listen(topic, receiver, h, decode=decode_stamp)

    def expect(self, now_ns: int, dt_ns: int) -> None:
        """Wait for the commands for a new state."""
        self._clear_answered()
        self.now_ns, self.dt_ns = now_ns, dt_ns
        self.commands.expect()
        self.scanned.clear()
        self.waiting_since, self.next_check = self.node.wall(), 0.0

    @property
    def complete(self) -> bool:
        """Return whether all commands, and scans where they count, are there."""
        return self.commands.complete and len(self.scanned) == len(self.scans)

    def _receiver(self, shepherd: int) -> Callable[[Vector], None]:
        def receive(command: Vector) -> None:
            ns = command.stamp_ns
            if ns is not None and not self._accepts(shepherd, ns, command.frame_id):
                return
            velocity = command.x, command.y
            if not all(abs(part) <= MAX_FLOAT32 for part in velocity):
                self._refuse(
                    'not_finite',
                    f'shepherd_{shepherd}: command {velocity} m/s is not finite: counts as zero',
                )
                velocity = math.nan, math.nan
            self.commands.add(shepherd, velocity)
            if self.complete:
                self.on_answers()

        return receive

    def _scan_receiver(self, name: str) -> Callable[[int], None]:
        def receive(ns: int) -> None:
            if ns == self.now_ns:
                self.scanned.add(name)
                if self.complete:
                    self.on_answers()

        return receive

    def _accepts(self, shepherd: int, ns: int, frame_id: str) -> bool:
        """Return whether a command of this stamp and frame counts now."""
        if frame_id != self.node.frame_id:
            self._refuse(
                'wrong_frame',
                f'shepherd_{shepherd}: command in frame {frame_id!r}, expected '
                f'{self.node.frame_id!r}: ignored; give velocities in the world frame',
            )
            return False
        age = self.now_ns - ns
        if age == 0:
            return True
        if not self.lockstep and 0 < age <= max(self.watchdog_steps, 1) * self.dt_ns:
            return True
        if age == self.dt_ns:  # the second answer to a state that was shown twice
            self.counts['late'] += 1
            return False
        self._refuse(
            'wrong_stamp',
            f'shepherd_{shepherd}: command stamped {seconds_text(ns)} s, expected '
            f'{seconds_text(self.now_ns)} s: ignored; copy the stamp of flock/poses, or start '
            'flock_sim with stamped:=false and publish Twist',
        )
        return False

    def _refuse(self, reason: str, text: str) -> None:
        self.counts[reason] += 1
        now = self.node.wall()
        if now - self.last_logged.get(reason, -REFUSAL_WARNING_PERIOD) >= REFUSAL_WARNING_PERIOD:
            self.last_logged[reason] = now
            self.node.get_logger().warning(text)

    def missing(self) -> list[str]:
        """Return the topics whose messages for the present state are missing."""
        silent = [COMMANDS.format(h=h) for h in self.commands.silent()]
        return silent + [name for name in self.scans if name not in self.scanned]

    def watch(self, patience: float) -> None:
        """Log the topics silent for longer than patience [s], each with its publishers."""
        self._clear_answered()
        now = self.node.wall()
        if self.complete or now < max(self.waiting_since + patience, self.next_check):
            return
        self.next_check = now + SILENCE_CHECK_PERIOD
        named = {name: self._reason(name) for name in self.missing()}
        if named != self.reasons:
            self.reasons = named
            self.node.get_logger().warning(
                f'waiting at {self.now_ns * 1e-9:.3f} s for {"; ".join(named.values())}: start or '
                'wake the node that answers, the episode then goes on'
            )

    def _clear_answered(self) -> None:
        """Remove the topics that have answered from the silent ones."""
        missing = self.missing() if self.reasons else []
        if answered := [name for name in self.reasons if name not in missing]:
            self.node.get_logger().info(f'{", ".join(answered)}: answering again')
            self.reasons = {
                name: reason for name, reason in self.reasons.items() if name in missing
            }

    def _reason(self, topic: str) -> str:
        """Return a topic with its publishers, and with those of the scans that they read."""
        scans = set()
        for writer in self.node.get_publishers_info_by_topic(topic):
            if writer.node_name == UNKNOWN_NODE_NAME:
                continue
            with suppress(NodeNameNonExistentError):
                subscriptions = self.node.get_subscriber_names_and_types_by_node(
                    writer.node_name, writer.node_namespace
                )
                scans |= {
                    name for name, kinds in subscriptions if 'sensor_msgs/msg/LaserScan' in kinds
                }
        reason = self.node.sourced(topic)
        if scans:
            reason = f'{reason[:-1]}, by {", ".join(map(self.node.sourced, sorted(scans)))})'
        return reason

    def diagnose(self) -> DiagnosticStatus:
        """Return the diagnostics of the commands."""
        self.writers.find(self.commands.n_shepherds)
        level, message = OK, 'every shepherd answers'
        if self.writers.unheard:
            shown = '; '.join(f'{topic} as {text}' for topic, text in self.writers.unheard.items())
            level, message = ERROR, f'commands of another type than {self.kind}: {shown}'
        elif self.reasons:
            level = ERROR
            message = f'no answer on {", ".join(self.reasons)}: {"; ".join(self.reasons.values())}'
        elif not self.lockstep:
            stopped = [
                f'shepherd_{h}' for h, age in enumerate(self.commands.age)
                if age > self.watchdog_steps
            ]  # fmt: skip
            if stopped:
                level, message = ERROR, 'stopped by the watchdog: ' + ', '.join(stopped)
        if level == OK and self.writers.rivals:
            rivals = ', '.join(sorted(self.writers.rivals))
            level, message = WARN, f'several nodes command {rivals}'
        if level == OK and self.counts['not_finite'] > self.reported_refusals:
            level, message = WARN, 'commands that are not finite count as zero'
        self.reported_refusals = self.counts['not_finite']
        counts = {name: self.counts[name] for name in ('not_finite', 'wrong_frame', 'wrong_stamp')}
        return self.node.status('commands', level, message, late=self.counts['late'], **counts)
