"""A node for each controller of the core: poses in, velocities out."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from shepherd_ros.controllers import CONTROLLERS
from shepherd_ros.controllers.controller import Controller, Memory
from shepherd_ros.nodes.mux_parameters import declare_source
from shepherd_ros.ros.intra_process import Output
from shepherd_ros.ros.node import OK, ShepherdNode, WARN
from shepherd_ros.ros.parameters import declare_config
from shepherd_ros.ros.runtime import run
from shepherd_ros.ros.world_subscriber import Listener
from shepherd_ros.sim import compiled
from shepherd_ros.sim.perception import perceive
from shepherd_ros.sim.presets import PRESETS
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.encode import encode_command, encode_twist
from shepherd_ros.wire.episode import Episode
from shepherd_ros.wire.topics import command_type
import torch

ALL_SHEPHERDS = -1
GENERIC = Controller.executable


class HeuristicNode(ShepherdNode):
    """Publishes a command for each of its shepherds, by default all, for every state."""

    def __init__(self, controller: str = '', **kwargs: Any) -> None:
        """Create the node of a controller; '': of the one that a parameter names."""
        compiled.start_numba()
        super().__init__(controller or GENERIC, **kwargs)
        if not controller:
            names = tuple(sorted(CONTROLLERS.keys() - {'policy'}))  # which has its own node
            doc = 'law of the commands: ' + ', '.join(names)
            controller = self.option('controller', 'strombom', doc, choices=names)
        self.kind = CONTROLLERS[controller]
        presets = tuple(sorted(PRESETS))
        doc = 'defaults of the options: ' + ', '.join(presets)
        self.preset: str = self.option('preset', 'default', doc, choices=presets)
        changes = PRESETS[self.preset].controllers.get(controller, {})
        self.options = declare_config(self, self.kind.config_type(**changes))
        self.shepherd_ids: list[int] = self.option(
            'shepherd_ids', [ALL_SHEPHERDS], 'shepherds to command; [-1]: all of the episode'
        )
        self.noise_std: float = self.option(
            'noise_std', 0.0, 'noise on all perceived positions [m]', low=0.0
        )
        self.commands = declare_source(self)
        self.stamped: bool = self.option(
            'stamped',
            True,
            'publish TwistStamped; false: Twist, which cannot be matched to a state',
        )
        self.controller: Controller | None = None
        self.memory: Memory = {}
        self.last: tuple[int, torch.Tensor] | None = None
        self.outputs: dict[int, Output] = {}
        self.listener = Listener(self, self.on_state, self.on_episode)

    def on_episode(self, episode: Episode, world: WorldConfig) -> None:
        """Create the controller and the publishers of an episode."""
        self.controller = self.kind.in_preset(self.options, world, self.preset)
        self.last = None
        ids = self.shepherd_ids
        team = range(episode.n_shepherds) if ALL_SHEPHERDS in ids else ids
        unknown = [h for h in team if not 0 <= h < episode.n_shepherds]
        if unknown:
            self.get_logger().error(
                f'shepherd_ids has {unknown}: expected 0 to {episode.n_shepherds - 1}, '
                'as this episode has no others; they get no commands'
            )
        commanded = [h for h in team if h not in unknown]
        for h in [h for h in self.outputs if h not in commanded]:
            self.destroy_publisher(self.outputs.pop(h))
        kind = command_type(self.stamped)
        for h in [h for h in commanded if h not in self.outputs]:
            self.outputs[h] = self.advertise(self.commands, h, kind)

    def on_state(self, ns: int, state: WorldState, episode: Episode) -> None:
        """Publish the commands for a state; the same again for a repeated state."""
        assert self.controller is not None
        if self.last is None or ns != self.last[0]:
            perceived = perceive(state, self.noise_std)
            if self.last is None or ns < self.last[0]:
                self.memory = self.controller.begin(perceived)
            command, self.memory = self.controller.act(perceived, self.memory)
            self.last = (ns, command)
        for h, output in self.outputs.items():
            x, y = self.last[1][h].tolist()
            stamped = encode_command(ns, self.frame_id, x, y)
            output.publish(stamped if self.stamped else encode_twist(x, y))

    def diagnose(self) -> list[DiagnosticStatus]:
        """Return the status of the controller: whether states arrive."""
        silence = self.listener.silence()
        return [
            self.status(
                'controller',
                WARN if silence else OK,
                silence or 'commanding',
                states=self.listener.states,
                shepherds=sorted(self.outputs),
            )
        ]


def main(name: str = '') -> int:
    """Run the controller that the parameter of that name names, such as one of a plug-in."""
    doc = CONTROLLERS[name].__doc__ if name else main.__doc__
    return run(lambda: HeuristicNode(name), name or GENERIC, doc or '')


def __getattr__(name: str) -> Callable[[], int]:
    """Return the main function of a controller's own executable, such as strombom."""
    if name.startswith('_') or name not in CONTROLLERS:
        raise AttributeError(name)
    return partial(main, name)
