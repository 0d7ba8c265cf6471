"""The node between controllers, persons and flock_sim: one source drives each shepherd."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from shepherd_ros.nodes.body_frame import BodyFrames
from shepherd_ros.nodes.command_mux import Choice, CommandMux, Velocity
from shepherd_ros.nodes.mux_parameters import declare_mux
from shepherd_ros.nodes.mux_requests import MuxRequests
from shepherd_ros.nodes.mux_sources import MuxSources
from shepherd_ros.ros.episode_subscriber import listen_to_episodes
from shepherd_ros.ros.intra_process import Output
from shepherd_ros.ros.node import ERROR, OK, ShepherdNode, WARN
from shepherd_ros.ros.runtime import run
from shepherd_ros.wire.decode import Poses
from shepherd_ros.wire.drivers import Drivers
from shepherd_ros.wire.encode import encode_command, encode_text, encode_twist
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import command_type, COMMANDS, DRIVERS, SHEPHERD, SHEPHERD_POSES

SILENCE_LOOK_PERIOD = 0.02  # [s] between two looks at who has fallen silent
LOG_PERIOD = 10.0  # [s] between two logs of a type that is not heard
TYPE_PERIOD = 0.2  # [s] between two looks at the types of sources
RESEND_RACE = (
    0.5  # [s] after its answers in which a state that is shown again may have crossed them
)


class MuxNode(ShepherdNode):
    """
    Publishes for each shepherd the commands of one of its sources, or zero.

    In lockstep the commands of all shepherds are published at once, when each has one: so a state
    gets exactly one command of each, and a switch holds from the next state on. In realtime a
    command goes out as it comes, and what changes goes out at once.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Create the node; sources are heard once an episode says which shepherds there are."""
        super().__init__('mux', **kwargs)
        options = declare_mux(self)
        self.body = options.body
        self.kind = command_type(options.stamped)
        self.mux = CommandMux(
            options.sources, options.locks, options.default, options.start_timeout
        )
        self.episode: Episode | None = None
        self.poses: Poses | None = None
        self.frames = BodyFrames()
        self.choices: list[Choice | None] = []  # as they were published last
        self.waiting = 0  # lockstep: the first shepherd without a command
        self.answered_at: float | None = None  # lockstep: when the present state was answered
        self.drivers: Drivers | None = None
        self.outputs: list[Output] = []
        self.sources = MuxSources(self, options, self.on_command)
        self.requests = MuxRequests(self, self.mux, options, self.on_change)
        self.drivers_output = self.advertise(DRIVERS)
        listen_to_episodes(self, Episode.from_json, self.on_episode)
        self.listen(SHEPHERD_POSES, self.on_poses)
        self.timer(SILENCE_LOOK_PERIOD, self.decide)
        self.timer(TYPE_PERIOD, self.sources.match)

    # ---- input ----

    def on_episode(self, episode: Episode) -> None:
        """Make ready for the team of an episode."""
        self.episode, n = episode, episode.n_shepherds
        self.mux.begin(n, episode.mode == 'lockstep', self.wall())
        self.frames = BodyFrames()
        self.choices = [None] * n
        while len(self.outputs) > n:
            self.destroy_publisher(self.outputs.pop())
        for h in range(len(self.outputs), n):
            self.outputs.append(self.advertise(COMMANDS, h, self.kind))
        self.sources.begin(n)
        self.requests.begin(n)
        if self.poses is not None:
            self.on_poses(self.poses)

    def on_poses(self, poses: Poses) -> None:
        """Answer the state that has these positions of the shepherds."""
        episode, self.poses = self.episode, poses
        if (
            episode is None
            or not episode.has(poses.stamp_ns)
            or len(poses.xy) != episode.n_shepherds
            or poses.frame_id != self.frame_id
        ):
            return
        now = self.wall()
        if self.mux.show(poses.stamp_ns, now):
            turns = [self._turn(choice) for choice in self.choices]
            self.frames.move(poses.xy, poses.heading, turns, episode.dt)
            self.waiting, self.answered_at = 0, None
            self.decide()
        elif self.answered_at is None:
            self.decide()
        else:  # answers were lost, or the world pauses: then what drives may be another by now
            if now - self.answered_at > RESEND_RACE:
                self._answer(anew=True)
            for h, choice in enumerate(self.choices):
                if choice is not None:
                    self._publish(h, choice)

    def on_command(
        self, name: str, shepherd: int | None, velocity: Velocity, stamp_ns: int | None
    ) -> None:
        """Take a command of a source."""
        team: Sequence[int] = range(self.mux.n_shepherds) if shepherd is None else [shepherd]
        for h in team:
            self.mux.receive(name, h, velocity, stamp_ns, self.wall())
        if self.mux.lockstep:
            self.decide()
        elif self._has_state():
            self._forward(team)

    def on_change(self) -> None:
        """Apply what was selected or locked, and publish it with the last drivers."""
        self.decide()
        if self.drivers is not None:
            self._publish_drivers(replace(self.drivers, **self._requested()))

    # ---- output ----

    def decide(self) -> None:
        """Publish the commands that are due."""
        if not self._has_state():
            return
        if not self.mux.lockstep:
            self._forward(range(self.mux.n_shepherds))
        elif self.answered_at is None:
            self._answer()

    def _has_state(self) -> bool:
        """Return whether a state of the present episode has been received."""
        return self.episode is not None and self.episode.has(self.mux.stamp_ns)

    def _answer(self, anew: bool = False) -> None:
        """In lockstep: answer the present state once every shepherd has a command."""
        now, n = self.wall(), self.mux.n_shepherds
        while not anew and self.waiting < n:
            if self.mux.choose(self.waiting, now) is None:
                return
            self.waiting += 1
        choices = [self.mux.choose(h, now) for h in range(n)]
        if None in choices:  # what is selected has changed meanwhile
            self.waiting = choices.index(None)
            return
        if not anew:
            self.answered_at = now
            for h, choice in enumerate(choices):
                if choice is not None:
                    self._publish(h, choice)
        self.choices = choices
        self._publish_drivers_of_step()

    def _forward(self, team: Sequence[int]) -> None:
        """In realtime: publish the commands of these shepherds that differ from their last."""
        now = self.wall()
        for h in team:
            choice, last = self.mux.choose(h, now), self.choices[h]
            if choice is None or choice == last:
                continue
            self.choices[h] = choice
            if last is None or choice.stamp_ns >= last.stamp_ns or choice.driver != last.driver:
                self._publish(h, choice)
        self._publish_drivers_of_step()

    def _publish(self, shepherd: int, choice: Choice) -> None:
        """Publish the command of a shepherd in the world frame."""
        x, y, _ = choice.velocity
        if choice.driver in self.body:
            x, y = self.frames.to_world(shepherd, choice.velocity)
        self.outputs[shepherd].publish(
            encode_twist(x, y)
            if self.kind != command_type(stamped=True)
            else encode_command(choice.stamp_ns, self.frame_id, x, y)
        )

    def _turn(self, choice: Choice | None) -> float | None:
        """Return the turn of a command in the frame of a body [rad/s], None for another one."""
        return choice.velocity[2] if choice is not None and choice.driver in self.body else None

    def _requested(self) -> dict[str, Any]:
        """Return what is selected and locked."""
        n = self.mux.n_shepherds
        return {
            'selected': tuple(self.mux.selected[:n]),
            'locked': tuple(self.mux.locked[:n]),
        }

    def _publish_drivers_of_step(self) -> None:
        """Publish the drivers of the present step."""
        assert self.episode is not None
        self._publish_drivers(
            Drivers(
                episode=self.episode.number,
                step=self.episode.step_of(self.mux.stamp_ns),
                stamp=self.mux.stamp_ns,
                drivers=tuple(None if c is None else c.driver for c in self.choices),
                **self._requested(),
            )
        )

    def _publish_drivers(self, drivers: Drivers) -> None:
        """Publish drivers, unless they were published before."""
        if drivers != self.drivers:
            self.drivers = drivers
            self.drivers_output.publish(encode_text(drivers.to_json()))

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return the drivers, and the shepherds that stand still for lack of one."""
        level, message = OK, 'every shepherd has a driver'
        drivers = () if self.drivers is None else self.drivers.drivers
        idle = [h for h, driver in enumerate(drivers) if driver is None]
        if self.poses is None:
            level, message = WARN, 'no state of the world heard yet'
        elif self.drivers is None:
            level, message = WARN, f'waiting for the first command of {self.mux.default}'
        elif idle:
            shown = ', '.join(SHEPHERD.format(h=h) for h in idle)
            level, message = WARN, f'zero is commanded, locked or its source silent: {shown}'
        values = {
            SHEPHERD.format(h=h): f'{driver or "zero"} (selected: {self.mux.selected[h]})'
            for h, driver in enumerate(drivers[: self.mux.n_shepherds])
        }
        return [self.status('drivers', level, message, **values), *self._diagnose_types()]

    def _diagnose_types(self) -> list[DiagnosticStatus]:
        """Return a status, also logged, if a node hears commands of the other type."""
        infos = self.get_subscriptions_info_by_topic(COMMANDS.format(h=0)) if self.outputs else []
        deaf = [f'{i.node_name} hears {i.topic_type}' for i in infos if i.topic_type != self.kind]
        if not deaf:
            return []
        message = (
            f'{COMMANDS.format(h=0)} is {self.kind}, but {", ".join(sorted(deaf))}: expected one '
            'type; give mux, flock_sim and controllers the same value of stamped'
        )
        self.get_logger().error(message, throttle_duration_sec=LOG_PERIOD)
        return [self.status('types', ERROR, message)]


def main() -> int:
    """Let one of several sources command each shepherd: controllers, keys, a joystick, a page."""
    return run(MuxNode, 'mux', main.__doc__ or '')
