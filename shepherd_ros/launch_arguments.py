"""The arguments of the launch files, checked before any process starts."""

from __future__ import annotations

from dataclasses import dataclass, fields
from importlib.util import find_spec
from pathlib import Path
import re
from typing import Any

from shepherd_ros.bringup import word_of
from shepherd_ros.config import Config, ConfigError, mapping, option, read
from shepherd_ros.experiments.setting import canonical_setting, Setting
from shepherd_ros.resources import is_installed
from shepherd_ros.sim.limits import MAX_SEED
from shepherd_ros.wire.episode import MODES
import yaml


@dataclass(frozen=True)
class Episodes(Config):
    """The episodes that flock_sim runs."""

    mode: str = option('lockstep', 'lockstep or realtime', choices=MODES)
    rate: float = option(
        0.0,
        'steps per second of wall time, in lockstep at most; 0: 1/dt in realtime, any in lockstep',
        low=0,
        high=1e4,
    )
    seed: int = option(0, 'seed of the first episode', low=-MAX_SEED, high=MAX_SEED)
    episodes: int = option(0, 'episodes to run; 0: without end', low=0)


# argument of the launch file -> field of the setting; an argument is called as the parameter is
_OF_SETTING = {
    f.metadata.get('path', '').rpartition('.')[2] or f.name: f
    for f in fields(Setting)
    if f.name != 'set'
}
# name -> default and description; empty means that the node's own default holds
LAUNCH_ARGUMENTS: dict[str, tuple[str, str]] = {
    'controller': ('strombom', 'a controller, or policy:CHECKPOINT; a wrong one shows all'),
    'checkpoint': ('', 'of the policy: a file, or the name of one that is shipped'),
    **{name: (word_of(f.default), f.metadata['doc']) for name, f in _OF_SETTING.items()},
    'set': ('', 'other options of the environment, such as "world.dt=0.2 lidar.range_noise=0.1"'),
    **{f.name: (word_of(f.default), f.metadata['doc']) for f in fields(Episodes)},
    'mux': ('false', 'one of several sources commands each shepherd: true or false'),
    'standby': ('', 'with mux: other controllers to switch to, such as "strombom pierson"'),
    'console': ('false', 'also serve the console, with mux: true or false'),
    'record': ('', 'new folder into which everything is recorded; empty: nothing is'),
    'params_file': ('', 'YAML file with parameters, which win over the arguments'),
    'namespace': ('', 'namespace of all nodes'),
    'rviz': ('false', 'also start RViz: true or false'),
    'foxglove': ('false', 'also serve the graph to Foxglove and Lichtblick: true or false'),
}


@dataclass(frozen=True)
class LaunchValues:
    """The arguments of the launch file in their types."""

    controller: str
    mux: bool
    console: bool
    standby: list[str]
    setting: Setting
    flock_sim: dict[str, Any]
    record: str
    params_file: str
    namespace: str
    rviz: bool
    foxglove: bool


def launch_values(given: dict[str, str]) -> LaunchValues:
    """Return the arguments of the launch file in their types, or raise ConfigError."""
    plain = Setting()  # with an example of each value
    named = {
        f.name: read(name, given[name], getattr(plain, f.name)) for name, f in _OF_SETTING.items()
    }
    paced = {f.name: read(f.name, given[f.name], f.default) for f in fields(Episodes)}
    controller, checkpoint = given['controller'], given['checkpoint']
    if checkpoint and controller != 'policy':
        raise ConfigError(
            f'checkpoint is {checkpoint!r}: expected none with controller:={controller}; a '
            'checkpoint needs controller:=policy'
        )
    if given['record'] and Path(given['record']).exists():
        raise ConfigError(
            f'record is {given["record"]!r}: expected a folder that is not there yet'
        )
    return LaunchValues(
        controller=f'{controller}:{checkpoint}' if checkpoint else controller,
        mux=read('mux', given['mux'], False) or read('console', given['console'], False),
        console=read('console', given['console'], False),
        standby=given['standby'].split(),
        setting=canonical_setting(Setting(**named, set=tuple(given['set'].split()))),
        flock_sim=Episodes(**paced).to_dict(),
        record=given['record'],
        **_of_all_nodes(given),
    )


def _of_all_nodes(given: dict[str, str]) -> dict[str, Any]:
    """Return what both launch files give to nodes and viewer, or raise ConfigError."""
    file, rviz = given['params_file'], read('rviz', given['rviz'], False)
    if file:
        try:
            content = yaml.safe_load(Path(file).read_text(encoding='utf-8'))
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            reason = ' '.join(str(error).split())
            raise ConfigError(f'params_file is {file}: expected a YAML file ({reason})') from None
        for node, parameters in mapping('params_file', content).items():
            mapping(f'{node} in params_file', parameters)
    if rviz and not is_installed('rviz2'):
        raise ConfigError(
            'rviz is true: expected false, as rviz2 is not installed; on Ubuntu apt install '
            'ros-$ROS_DISTRO-rviz2'
        )
    if not re.fullmatch(r'/?([A-Za-z]\w*(/[A-Za-z]\w*)*/?)?', given['namespace']):
        raise ConfigError(
            f'namespace is {given["namespace"]!r}: expected letters, digits and _, such as farm'
        )
    foxglove = read('foxglove', given['foxglove'], False)
    if foxglove and find_spec('foxglove') is None:
        raise ConfigError(
            'foxglove is true: expected false, as its package is not installed; pip install '
            'foxglove-sdk'
        )
    shared = {'params_file': file, 'namespace': given['namespace']}
    return shared | {'rviz': rviz, 'foxglove': foxglove}


def require_success(process: str, returncode: int) -> None:
    """Raise ConfigError for the exit code of a node that failed, so that launch ends with 1."""
    if returncode > 0:
        raise ConfigError(f'{process} ended with exit code {returncode}: its log says why')


REPLAY_ARGUMENTS: dict[str, tuple[str, str]] = {
    'bag': ('', 'folder of a bag, or one .mcap file'),
    'rate': ('1.0', 'pace; 2.0 is twice as fast'),
    'loop': ('false', 'begin anew at the end: true or false'),
    'controller': ('', 'controller, or policy:CHECKPOINT, that answers; empty: none does'),
    'delay': ('5.0', 'seconds that the controller gets to start before the bag is played'),
    'params_file': ('', 'YAML file with parameters of the controller'),
    'namespace': ('', 'namespace of all topics; empty: that of the recording'),
    'rviz': ('false', 'also start RViz: true or false'),
    'foxglove': ('false', 'also serve the graph to Foxglove and Lichtblick: true or false'),
}


@dataclass(frozen=True)
class ReplayValues:
    """Processes that the launch file starts to play a bag."""

    player: list[str]  # words of its command line
    remaps: list[tuple[str, str]]  # of the player
    delay: float  # [s] before the player is started
    controller: str
    n_shepherds: int
    params_file: str
    namespace: str
    rviz: bool
    foxglove: bool


def replay_values(given: dict[str, str], topics: list[str]) -> ReplayValues:
    """
    Return the arguments of the launch file with what follows from the topics of the bag.

    With a controller, recorded commands are not played. Raises ConfigError.
    """
    recorded = next((n.removesuffix('/episode') for n in topics if n.endswith('/episode')), '')
    space = given['namespace'].strip('/')
    remaps = [
        (name, f'/{space}{name.removeprefix(recorded)}')
        for name in topics
        if space and name.startswith(f'{recorded}/') and name not in ('/clock', '/diagnostics')
    ]
    rate, delay = (
        read(name, given[name], float(REPLAY_ARGUMENTS[name][0])) for name in ('rate', 'delay')
    )
    words = [given['bag'], '--rate', str(rate)]
    words += ['--loop'] if read('loop', given['loop'], False) else []
    commands = [name for name in topics if name.endswith('/cmd_vel')]
    if given['controller']:
        words += ['--topics', *(name for name in topics if name not in commands)]
    shared = _of_all_nodes(given) | {'namespace': space or recorded.strip('/')}
    return ReplayValues(
        player=words,
        remaps=remaps,
        delay=delay if given['controller'] else 0.0,
        controller=given['controller'],
        n_shepherds=len(commands),
        **shared,
    )
