"""The metrics node: poses in, the paper's metrics of the running episode out."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from shepherd_ros.ros.node import OK, ShepherdNode, WARN
from shepherd_ros.ros.runtime import run
from shepherd_ros.ros.world_subscriber import Listener
from shepherd_ros.sim.metrics import (
    count_step,
    METRICS,
    metrics,
    MetricsTally,
    PAPER_METRICS,
    start_tally,
)
from shepherd_ros.sim.state import WorldState
from shepherd_ros.wire.encode import encode_number
from shepherd_ros.wire.episode import Episode


class MetricsNode(ShepherdNode):
    """Counts every step; an episode heard only in part is reported as such, not guessed."""

    def __init__(self, **kwargs: Any) -> None:
        """Create the node and its publishers."""
        super().__init__('metrics', **kwargs)
        self.outputs = {name: self.advertise(f'metrics/{name}') for name in METRICS}
        self.tally: MetricsTally | None = None
        self.before: WorldState | None = None
        self.values: dict[str, float] = {}
        self.gaps = 0
        self.reported = False
        self.listener = Listener(self, self.on_state, self.on_episode)

    def on_episode(self, episode: Episode) -> None:
        """Start counting anew."""
        self.before, self.gaps, self.reported = None, 0, False

    def on_state(self, ns: int, state: WorldState, episode: Episode) -> None:
        """Count a step and publish what the metrics are now."""
        step = int(state.step)
        if self.before is None or self.tally is None or step < int(self.before.step):
            self.tally = start_tally(state)
            self.gaps = int(step > 0)
        elif step > int(self.before.step):  # a state that is shown again counts once
            self.gaps += int(step > int(self.before.step) + 1)
            self.tally = count_step(self.tally, self.before, state)
        self.before = state
        steps = episode.world.episode_steps
        self.values = {k: float(v) for k, v in metrics(self.tally, state, steps).items()}
        for name, value in self.values.items():
            self.outputs[name].publish(encode_number(value))
        if step == steps and not self.reported:
            self.reported = True
            shown = ', '.join(f'{name} {self.values[name]:.4g}' for name in PAPER_METRICS)
            lost = f' (heard with {self.gaps} gaps)' if self.gaps else ''
            self.get_logger().info(f'episode {episode.number}, seed {episode.seed}{lost}: {shown}')

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return whether every step was heard."""
        level, message = OK, 'counting'
        if self.listener.states == 0:
            level, message = WARN, 'no state of the world heard yet'
        elif self.gaps:
            level, message = WARN, 'steps of this episode were missed: its metrics are not whole'
        shown = {name: f'{value:.6g}' for name, value in self.values.items()}
        return [self.status('metrics', level, message, gaps=self.gaps, **shown)]


def main() -> int:
    """Run the paper's five metrics, live, as scalar topics."""
    return run(MetricsNode, 'metrics', main.__doc__ or '')
