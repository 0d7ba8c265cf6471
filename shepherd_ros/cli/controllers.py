"""A controller of the core with the parameters that its node would be given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TYPE_CHECKING

from shepherd_ros.bringup import controller_process, Process
from shepherd_ros.cli.user_error import UserError
from shepherd_ros.config import Config, mapping, unknown_name
import yaml

if TYPE_CHECKING:
    from shepherd_ros.controllers.controller import Controller
    from shepherd_ros.sim.world import WorldConfig

OF_NODES = ('executor', 'frame_id', 'shepherd_ids', 'stale_after', 'stamped', 'use_sim_time')


@dataclass(frozen=True)
class Chosen:
    """A controller by name, its ROS parameters, and the noise of its perception."""

    name: str
    parameters: dict[str, Any] = field(default_factory=dict)

    @property
    def noise_std(self) -> float:
        """Return the noise on perceived positions [m]."""
        return float(self.parameters.get('noise_std', 0.0))

    @property
    def of_core(self) -> bool:
        """Return whether it is an entry of shepherd_ros.controllers."""
        from shepherd_ros.controllers import CONTROLLERS

        return self.name in CONTROLLERS

    def config(self) -> Config:
        """Return the options of the law; raises ConfigError."""
        from shepherd_ros.controllers import CONTROLLERS

        kind = CONTROLLERS[self.name].config_type
        known = [f.name for f in fields(kind)]
        for name in self.parameters:
            if name not in (*known, 'noise_std', *OF_NODES):
                raise unknown_name(f'parameter of {self.name}', name, [*known, 'noise_std'])
        return kind(**{k: v for k, v in self.parameters.items() if k in known})

    def process(self, parameters: Mapping[str, Any]) -> Process:
        """Return its process, with parameters that its own win over."""
        given = {**parameters, **self.parameters}
        if self.of_core:
            return controller_process(self.name, {}, **given)
        return Process(self.name, self.name, given)

    def make(self, world: WorldConfig) -> Controller:
        """Return the controller for a world; raises ConfigError."""
        from shepherd_ros.controllers import CONTROLLERS

        return CONTROLLERS[self.name](self.config(), world)


def chosen(name: str, words: Sequence[str], params_file: Path | None) -> Chosen:
    """
    Return a controller with the parameters of a file, then those of words such as gain:=0.1.

    policy:CHECKPOINT is a policy with that parameter, composite:DRIVE,HOLD one with those. A file
    is one of ROS 2; what it says of other nodes does not count. Raises UserError.
    """
    name, _, text = name.partition(':')
    parameters = {} if params_file is None else _of_file(name, params_file)
    if text:
        from shepherd_ros.controllers import CONTROLLERS

        parameters |= CONTROLLERS[name].options_of(text)
    for word in words:
        key, given, value = word.partition(':=')
        try:
            parameters[key] = yaml.safe_load(value)
        except yaml.YAMLError:
            given = ''
        if not (key and given and value):
            raise UserError(f'--params has {word!r}: expected name:=value, such as noise_std:=0.5')
    return Chosen(name, parameters)


def _of_file(name: str, path: Path) -> dict[str, Any]:
    """Return the parameters that a file has for the node of a controller."""
    try:
        text = path.read_text(encoding='utf-8')
        nodes = mapping(str(path), yaml.safe_load(text))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        what = ' '.join(str(error).split())
        raise UserError(f'--params-file is {path}: expected a YAML file ({what})') from None
    parameters: dict[str, Any] = {}
    for node, content in nodes.items():
        if str(node).lstrip('/') in ('**', name, f'**/{name}', f'*/{name}'):
            given = mapping(str(node), content).get('ros__parameters', {})
            parameters |= mapping('ros__parameters', given)
    return parameters
