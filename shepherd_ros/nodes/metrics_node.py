"""The metrics node: poses in, the paper's metrics of the running episode out."""

from __future__ import annotations

from dataclasses import replace
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from shepherd_ros.ros.node import OK, ShepherdNode, WARN
from shepherd_ros.ros.runtime import run
from shepherd_ros.ros.world_subscriber import Listener
from shepherd_ros.sim.metrics import METRICS, shown
from shepherd_ros.sim.rollout import advance_to, EnvConfig, Moment, start
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.encode import encode_number
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import metric_topic


class MetricsNode(ShepherdNode):
    """
    Counts every step.

    Of an episode that is heard only in part, metrics that count over time are NaN.
    """

    backlog = 10_000  # a busy machine lets it run late, and it needs every state

    def __init__(self, **kwargs: Any) -> None:
        """Create the node and its publishers."""
        super().__init__('metrics', **kwargs)
        self.world = WorldConfig()
        self.outputs = {name: self.advertise(metric_topic(name)) for name in METRICS}
        self.moment: Moment | None = None
        self.values: dict[str, float] = {}
        self.gaps = 0
        self.reported = False
        self.listener = Listener(self, self.on_state, self.on_episode)

    def on_episode(self, episode: Episode, world: WorldConfig) -> None:
        """Start counting anew, the metrics of its task."""
        self.world, known = world, world.task.metrics
        for name in self.outputs.keys() - set(known):
            self.destroy_publisher(self.outputs.pop(name))
        for name in [name for name in known if name not in self.outputs]:
            self.outputs[name] = self.advertise(metric_topic(name))
        self.moment, self.gaps, self.reported = None, 0, False

    def on_state(self, ns: int, state: WorldState, episode: Episode) -> None:
        """Count a step and publish the metrics."""
        step = int(state.step)
        last = -1 if self.moment is None else int(self.moment.state.step)
        if self.moment is None or step < last:
            self.moment = start(state, EnvConfig(world=self.world))
            self.gaps = int(step > 0)
        elif step > last:
            self.moment = advance_to(self.moment, state)
            self.gaps += int(step > last + 1)
        else:  # a state that is shown again counts once
            self.moment = replace(self.moment, state=state)
        metrics = self.world.task.metrics
        self.values = {
            name: math.nan if self.gaps and not metrics[name].instant else float(value)
            for name, value in self.moment.metrics().items()
        }
        for name, value in self.values.items():
            self.outputs[name].publish(encode_number(value))
        if self.moment.ended and not self.reported:
            self.reported = True
            self._report(episode)

    def _report(self, episode: Episode) -> None:
        """Say how an episode went that is over."""
        name = f'episode {episode.number}, seed {episode.seed}'
        if self.gaps:
            self.get_logger().warning(
                f'{name}: not whole, states are missing at {self.gaps} places; no metrics'
            )
            return
        names = [metric.name for metric in shown('summary', self.world.task.metrics)][:5]
        text = ', '.join(f'{name} {self.values[name]:.4g}' for name in names)
        self.get_logger().info(f'{name}: {text}')

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return the status of the metrics: whether every step was received."""
        level, message = OK, 'counting'
        if silence := self.listener.silence():
            level, message = WARN, silence
        elif self.gaps:
            level, message = (
                WARN,
                'states of this episode were missed: no metrics that count over time',
            )
        shown = {name: f'{value:.6g}' for name, value in self.values.items()}
        return [self.status('metrics', level, message, gaps=self.gaps, **shown)]


def main() -> int:
    """Run the paper's five metrics, live, as scalar topics."""
    return run(MetricsNode, 'metrics', main.__doc__ or '')
