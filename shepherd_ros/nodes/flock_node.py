"""The simulator node: it moves sheep and shepherds, and publishes the true state."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from shepherd_ros.nodes.flock_commands import FlockCommands
from shepherd_ros.nodes.flock_pacing import Pacing
from shepherd_ros.nodes.flock_parameters import check_changes, declare_rate, WorldParameters
from shepherd_ros.nodes.flock_publishers import WorldOutput
from shepherd_ros.nodes.flock_requests import FlockRequests
from shepherd_ros.ros.node import OK, ShepherdNode, WARN
from shepherd_ros.ros.runtime import run
from shepherd_ros.sim import compiled
from shepherd_ros.sim.limits import MAX_SEED
from shepherd_ros.sim.rollout import advance, EnvConfig, start
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.wire.episode import Episode, MODES
from shepherd_ros.wire.topics import SHEEP_POSES, SHEPHERD_POSES
import torch
from torch import Tensor

WATCH_PERIOD = 0.05  # [s] wall time between two looks at who is silent
PAUSED_RESEND = 1.0  # [s] wall time after which a paused world shows its state again


class FlockSim(ShepherdNode):
    """
    Runs one episode after another.

    In lockstep the world moves as soon as every shepherd has answered the present state; in
    realtime a wall timer moves it, and a shepherd that is silent keeps its last command until
    the watchdog stops it.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Create the node and start the first episode."""
        compiled.start_numba()
        super().__init__('flock_sim', **kwargs)
        self.world_parameters = WorldParameters(self)
        self.world = self.world_parameters.present()
        self.next_seed: int = self.option(
            'seed', 0, 'seed of the next episode once it is set; each after it has 1 more',
            read_only=False, low=-MAX_SEED, high=MAX_SEED,
        )  # fmt: skip
        self.option('step_size', 1, 'steps that ~/step makes', read_only=False, low=1)
        self.episodes: int = self.option('episodes', 0, 'episodes to run; 0: without end', low=0)
        self.mode: str = self.option('mode', 'lockstep', 'how the world advances', choices=MODES)
        self.rate = declare_rate(self)
        self.resend: float = self.option(
            'resend_period', 0.25, 'lockstep: show an unanswered state again after [s]', low=0.01
        )
        self.patience: float = self.option(
            'silence_warning', 2.0, 'lockstep: name a silent shepherd after [s]', low=0.1
        )
        self.number, self.now_ns, self.last_published = -1, 0, 0.0
        self.dt_ns = round(self.world.dt * 1e9)
        self.pending_goal: Tensor | None = None
        self.pacing = Pacing(self.wall())
        self.output = WorldOutput(self)
        self.flock_commands = FlockCommands(self, self.on_answers)
        self.requests = FlockRequests(
            self, self.pacing, self.begin_episode, self.move_goal, self.resume
        )
        self.ticker = self.timer(self.period, self.on_tick)
        self.begin_episode()
        self.keep_pace()
        self.timer(WATCH_PERIOD, self.watch)
        self.add_on_set_parameters_callback(partial(check_changes, self.world_parameters))
        self.add_post_set_parameters_callback(self.on_parameters)

    @property
    def period(self) -> float:
        """Return the wall time of a step in realtime [s]."""
        return 1 / self.rate if self.rate > 0 else self.world.dt

    @property
    def state(self) -> WorldState:
        """Return the true state."""
        return self.moment.state

    # ---- the course of an episode ----

    def begin_episode(self) -> Episode:
        """Start the next episode and return it."""
        self.world = self.world_parameters.present()
        if self.dt_ns != (dt_ns := round(self.world.dt * 1e9)):
            self.dt_ns = dt_ns
            self.keep_pace()
        seed = self.next_seed
        self.next_seed, self.number = seed + 1, self.number + 1
        self.now_ns += self.dt_ns
        state = spawn(self.world, torch.tensor(seed))
        team = int(state.team_size)
        present = {name: getattr(state, name)[:team] for name in ('shepherds', 'shepherd_mask')}
        config = EnvConfig(world=self.world)
        self.moment = start(replace(state, **present), config, count=False)
        self.episode = Episode(
            number=self.number,
            seed=seed,
            start_ns=self.now_ns,
            n_sheep=self.world.n_sheep,
            n_shepherds=team,
            goal_radius=float(self.state.goal_radius),
            frame_id=self.frame_id,
            mode=self.mode,
            world=self.world.to_dict(),
        )
        self.flock_commands.begin(self.episode)
        self.output.episode(self.now_ns, self.episode, self.state)
        self.get_logger().info(
            f'episode {self.number}: seed {seed}, {self.world.n_sheep} sheep, {team} shepherds, '
            f'{self.world.episode_steps} steps of {self.world.dt:g} s, {self.mode}'
        )
        self.publish_state()
        return self.episode

    def advance(self, commands: list[tuple[float, float]]) -> None:
        """Make one step with commands (H, 2) m/s, or begin the next episode after the last."""
        if self.moment.ended:
            if self.number + 1 == self.episodes:
                self.finish()
            else:
                self.begin_episode()
            return
        velocity = torch.tensor(commands, dtype=torch.float32).reshape(-1, 2)
        self.moment = advance(self.moment, velocity)
        self.now_ns += self.dt_ns
        if self.pending_goal is not None:
            self.set_goal(self.pending_goal)
        self.publish_state()
        self.episode = self.output.end(self.now_ns, self.episode, self.moment)

    def finish(self) -> None:
        """Stop after the last episode, once its last messages are out."""
        if not self.finished:
            self.get_logger().info(f'{self.episodes} episodes done')
            self.publish_diagnostics()
            self.output.wait(SHEEP_POSES, SHEPHERD_POSES, seconds=1.0)
            self.finished = True

    # ---- what makes it move ----

    def on_answers(self) -> None:
        """In lockstep: every shepherd has answered."""
        if self.mode == 'lockstep' and not self.finished and self.pacing.may_move():
            self.advance(self.flock_commands.commands.velocities)

    def on_tick(self) -> None:
        """Make a step in realtime; in lockstep it may be made once every shepherd has answered."""
        self.pacing.held = False
        if self.mode == 'lockstep':
            self.resume()
        elif not self.finished and self.pacing.may_move():
            self.advance(self.flock_commands.commands.held(self.flock_commands.watchdog_steps))

    def keep_pace(self) -> None:
        """Set the timer of steps to the rate; in lockstep that is the highest rate."""
        paced = self.mode == 'realtime' or self.rate > 0
        self.pacing.limited = self.pacing.held = paced and self.mode == 'lockstep'
        self.ticker.timer_period_ns = round(self.period * 1e9)
        if paced:
            self.ticker.reset()
        else:
            self.ticker.cancel()

    def resume(self) -> None:
        """Go on after the end of a pause or a request of steps."""
        if self.mode == 'lockstep' and self.flock_commands.complete:
            self.on_answers()

    def watch(self) -> None:
        """In lockstep: publish a state without response again, and log silent shepherds."""
        if not self.pacing.settled:
            if self.pacing.settle(self.output.readers(), self.wall()):
                self.publish_state(again=True)
            elif self.pacing.settled:
                self.resume()
        if self.finished or self.mode != 'lockstep':
            return
        waited = self.wall() - self.last_published
        if self.flock_commands.complete:
            if waited > PAUSED_RESEND:
                self.publish_state(again=True)
        elif waited > self.resend:
            if self.flock_commands.reasons:  # who is silent for long may know of another episode
                self.output.episode(self.now_ns, self.episode, self.state, seconds=0.0)
            self.publish_state(again=True)
        self.flock_commands.watch(self.patience)

    # ---- what it publishes ----

    def publish_state(self, again: bool = False) -> None:
        """Publish the present state, and expect answers to it."""
        if not again:
            self.flock_commands.expect(self.now_ns, self.dt_ns)
        self.last_published = self.wall()
        self.output.state(self.now_ns, self.state, self.moment.before)

    def set_goal(self, goal: Tensor) -> None:
        """Move the goal now, (2,) m."""
        self.pending_goal = None
        self.moment = replace(self.moment, state=replace(self.state, goal=goal))
        self.output.goal(self.now_ns, self.state)

    def move_goal(self, x: float, y: float) -> None:
        """Move the goal before the next state is published; at once in a paused world."""
        self.get_logger().info(f'goal moves to {x:g}, {y:g} m')
        self.pending_goal = torch.tensor([x, y], dtype=torch.float32)
        if self.pacing.resting:
            self.set_goal(self.pending_goal)

    def on_rivals(self) -> None:
        """Publish the latched topics again, after those of a rival."""
        self.output.episode(self.now_ns, self.episode, self.state, seconds=0.0)

    # ---- parameters and diagnostics ----

    def on_parameters(self, parameters: list[Parameter]) -> None:
        """Apply a new rate at once, and parameters of the world from the next episode on."""
        for parameter in parameters:
            if parameter.name == 'seed':
                self.next_seed = parameter.value
            elif parameter.name == 'rate':
                self.rate = parameter.value
                self.keep_pace()
                self.resume()
            elif parameter.name == 'preset':
                self.world_parameters.take(parameter.value)

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return the diagnostics of the episode and of the commands."""
        due = 1 / self.period if self.mode == 'realtime' else 0.0
        rate, fault = self.pacing.report(self.wall(), due)
        episode = self.status(
            'episode', WARN if fault else OK, fault or 'running', episode=self.number,
            seed=self.episode.seed, step=int(self.state.step), steps_per_second=round(rate, 1),
            mode=self.mode,
        )  # fmt: skip
        return [episode, self.flock_commands.diagnose()]


def main() -> int:
    """Own the world: move sheep and shepherds, publish poses, goal, episode and /clock."""
    return run(FlockSim, 'flock_sim', main.__doc__ or '')
