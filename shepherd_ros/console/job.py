"""
A job of the console as a process: `python -m shepherd_ros.console.job KIND`.

It reads what is asked as a line of JSON, and writes lines: `done` and `text` on the way, `result`
or `error` at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
import json
import os
from pathlib import Path
import secrets
import sys
from typing import Any, TYPE_CHECKING

from shepherd_ros.config import ConfigError

if TYPE_CHECKING:
    from shepherd_ros.recordings.episodes import RecordedEpisode

NICENESS = 5  # below the nodes of the graph, above trainings in the background


def _say(**content: Any) -> None:
    """Write a line; what is not finite must not be in it."""
    print(json.dumps(content, allow_nan=False), flush=True)


def _list_bags(request: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return what message `bags` tells of each bag in a folder, newest first."""
    from shepherd_ros.recordings.grouping import announced_episodes, namespaces
    from shepherd_ros.rosbag2.errors import BagError
    from shepherd_ros.rosbag2.reader import open_bag

    found = []
    for path in Path(request['record_dir']).glob('*'):
        if path.is_symlink() or not (path.suffix == '.mcap' or any(path.glob('*.mcap'))):
            continue
        entry: dict[str, Any] = {'name': path.name, 'episodes': [], 'start': path.stat().st_mtime}
        try:
            bag = open_bag(path)
            announced = [
                info for space in namespaces(bag) for _, info in announced_episodes(bag, space)
            ]
            seen = {(info.number, info.seed): info for info in announced}
            entry |= {
                'size': sum(storage.size for storage in bag.storages),
                'start': bag.start_ns * 1e-9,
                'duration': (bag.end_ns - bag.start_ns) * 1e-9,
                'messages': bag.count,
                'episodes': [
                    {
                        'number': info.number,
                        'seed': info.seed,
                        'n_sheep': info.n_sheep,
                        'n_shepherds': info.n_shepherds,
                        'steps': info.episode_steps,
                    }
                    for info in seen.values()
                ],
            }
        except (BagError, OSError) as error:
            entry['error'] = str(error)
        found.append(entry)
    return sorted(found, key=lambda bag: -bag['start'])


def _episode(path: str, number: int) -> RecordedEpisode:
    """Return an episode of a bag that has states, or raise ConfigError."""
    from shepherd_ros.recordings.episodes import iter_episodes
    from shepherd_ros.recordings.grouping import namespaces
    from shepherd_ros.rosbag2.reader import open_bag

    bag = open_bag(Path(path))
    episodes = (e for space in namespaces(bag) for e in iter_episodes(bag, space))
    count = 0
    for count, episode in enumerate(episodes, 1):
        if count - 1 == number:
            if not episode.frames:
                raise ConfigError(f'episode {number} has no whole state: expected some')
            return episode
    raise ConfigError(f'episode is {number}: expected less than {count}, counted from 0')


def _written(episode: RecordedEpisode, title: str, folder: str) -> str:
    """Write the record of a replay page and return the name of the file."""
    from shepherd_ros.recordings.replay import (
        metrics_over_time,
        ranges_of,
        states_of,
        task_of,
        track_of,
    )
    from shepherd_ros.sim.metrics import shown
    from shepherd_ros.view.page import page_record

    task = task_of(episode)
    curves = metrics_over_time(states_of(episode), episode.episode_steps, task)
    record = page_record(
        track_of(episode, title),
        {metric.name: curves[metric.name] for metric in shown('page', task.metrics)},
        {metric.name: metric.unit for metric in shown('page', task.metrics)},
        ranges_of(episode),
    )
    name = f'{secrets.token_hex(12)}.json'
    Path(folder, name).write_text(json.dumps(record, allow_nan=False), encoding='utf-8')
    return name


def _replay(request: Mapping[str, Any]) -> dict[str, Any]:
    """Return where the record of an episode is."""
    _say(done=0.1, text='reading the bag')
    episode = _episode(request['path'], request.get('episode', 0))
    _say(done=0.5, text='packing the episode')
    title = f'{request["bag"]}, episode {episode.number}'
    return {'tracks': [{'name': title, 'url': _written(episode, title, request['folder'])}]}


def _counterfactual(request: Mapping[str, Any]) -> dict[str, Any]:
    """Return where the records of an episode and of its other future are."""
    from shepherd_ros.experiments.methods import full_name, method_in
    from shepherd_ros.recordings.counterfactual import record_future
    from shepherd_ros.recordings.episodes import iter_episodes
    from shepherd_ros.rosbag2.reader import open_bag
    from shepherd_ros.sim.rollout import EnvConfig
    from shepherd_ros.sim.world import WorldConfig

    _say(done=0.0, text='reading the bag')
    recorded = _episode(request['path'], request.get('episode', 0))
    steps = [frame.step for frame in recorded.frames]
    if request['step'] not in steps:
        raise ConfigError(f'step is {request["step"]}: expected one of {steps[0]} to {steps[-1]}')
    at = steps.index(request['step'])
    config = EnvConfig(world=WorldConfig.from_dict(recorded.world))
    controller = method_in(config, full_name(request['controller']))
    made, total = 0, recorded.episode_steps + 1

    def on_step(worlds: int) -> None:
        nonlocal made
        made += worlds
        if made % max(total // 50, 1) == 0:
            _say(done=min(0.9, 0.9 * made / total), text=f'{request["controller"]} drives on')

    folder = Path(request['folder'], secrets.token_hex(12))
    record_future(recorded, at, controller, 0.0, folder, on_step)
    (future,) = iter_episodes(open_bag(folder))
    return {
        'tracks': [
            {'name': 'recorded', 'url': _written(recorded, 'recorded', request['folder'])},
            {
                'name': request['controller'],
                'url': _written(future, request['controller'], request['folder']),
            },
        ],
        'parting': request['step'],
        'table': _table(recorded, future),
    }


def _table(recorded: RecordedEpisode, future: RecordedEpisode) -> list[dict[str, Any]]:
    """Return the metrics of both after the last step that both have."""
    from shepherd_ros.recordings.replay import metrics_over_time, states_of, task_of
    from shepherd_ros.sim.metrics import shown

    last = max({f.step for f in recorded.frames} & {f.step for f in future.frames})
    task, columns = task_of(recorded), []
    for episode in (recorded, future):
        cut = replace(episode, frames=[f for f in episode.frames if f.step <= last])
        columns.append(metrics_over_time(states_of(cut), episode.episode_steps, task))
    return [
        {'name': m.name, 'unit': m.unit, 'values': [float(c[m.name][-1]) for c in columns]}
        for m in shown('page', task.metrics)
    ]


def _catalog(request: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the controllers, and the checkpoints with a trained critic, that are shipped."""
    from shepherd_ros.controllers import CONTROLLERS
    from shepherd_ros.experiments.value_map import has_critic
    from shepherd_ros.policy.checkpoint import shipped_checkpoints

    shipped = sorted(shipped_checkpoints())
    names = sorted(CONTROLLERS.keys() - {'policy'})
    policies = [f'policy:{name}' for name in shipped]
    taught = [name for name, policy in zip(shipped, policies, strict=True) if has_critic(policy)]
    return {'controllers': names + policies, 'checkpoints': taught}


def _map_values(request: Mapping[str, Any]) -> None:
    """Map the values of each state that comes as a line."""
    from shepherd_ros.console.job_values import map_states

    map_states(request, _say)


JOB_KINDS: dict[str, Callable[[Mapping[str, Any]], Any]] = {
    'bags': _list_bags,
    'catalog': _catalog,
    'counterfactual': _counterfactual,
    'replay': _replay,
    'value_map': _map_values,
}


def main() -> int:
    """Do the job that the command line names."""
    os.nice(NICENESS)
    request = json.loads(sys.stdin.readline())
    try:
        result = JOB_KINDS[sys.argv[1]](request)
        if result is not None:
            _say(result=result)
    except (ConfigError, OSError) as error:  # BagError is one of them
        _say(error=str(error))
    return 0


if __name__ == '__main__':
    sys.exit(main())
