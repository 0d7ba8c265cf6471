"""Stored data outlives a new option, a new metric and a new column."""

from __future__ import annotations

from dataclasses import make_dataclass, replace
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet
import pytest
from shepherd_ros import __version__
from shepherd_ros.cli import main
from shepherd_ros.config import Config, ConfigError, option
from shepherd_ros.controllers import CONTROLLERS
from shepherd_ros.controllers.pierson import PiersonConfig
from shepherd_ros.experiments import cells, results
from shepherd_ros.experiments.catalog import EXPERIMENTS
from shepherd_ros.experiments.cells import Cell
from shepherd_ros.experiments.results import cell_key, read_results, results_in, schema, write_rows
from shepherd_ros.experiments.samples import samples_of
from shepherd_ros.experiments.setting import env_config, Setting
from shepherd_ros.learning.ppo import PPOConfig
from shepherd_ros.learning.run_folder import RunFolder
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.train_ppo import PPORunConfig
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import PolicyConfig
from shepherd_ros.recordings.check import check_bag
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.sim.env import EnvConfig
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.reward import RewardConfig
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.sim.world_parameters import WORLD_PARAMETERS, WorldParameter
from shepherd_ros.wire.episode import Episode

ROWS = Path(__file__).resolve().parents[2] / 'docs' / 'results' / 'rows.parquet'
WORDS = ['--sheep', '3', '--steps', '4', '--episodes', '2', '--controllers', 'pierson', 'idle']


def with_option(kind: type[Config], name: str = 'wind', default: Any = 0.0) -> type[Config]:
    """Return a configuration of the same name with one option more."""
    new = make_dataclass(
        kind.__name__, [(name, type(default), option(default, 'new'))], bases=(kind,), frozen=True
    )
    new.__doc__ = kind.__doc__
    return new


def without(data: Any, name: str) -> Any:
    """Return nested plain data without a name, as a version before wrote it."""
    if not isinstance(data, dict):
        return data
    return {key: without(value, name) for key, value in data.items() if key != name}


@pytest.mark.parametrize(
    'config',
    [
        EnvConfig(),
        WorldConfig(n_sheep=5, flock=ReynoldsFlock(max_acceleration=2.0)),
        EnvConfig(noise_std=0.5, reward=RewardConfig(occupancy=1.0)),
        PPORunConfig(samples=7, ppo=PPOConfig(minibatch_size=4), task=TaskConfig(noise_max=1.0)),
        PolicyConfig(network=NetworkConfig(hidden=8)),
    ],
)
def test_changes_say_what_differs_and_are_enough_to_make_it_again(config: Config) -> None:
    kind = type(config)
    assert kind.from_dict(json.loads(json.dumps(config.changes()))) == config
    assert config.equals(config.to_dict())
    assert config.equals(config.changes())


def test_changes_by_hand() -> None:
    assert TaskConfig().changes() == {}
    world = WorldConfig(n_sheep=5)
    assert world.changes() == {'n_sheep': 5, 'flock': {'model': 'strombom'}}
    env = EnvConfig(noise_std=0.5, world=replace(world, flock=ReynoldsFlock(max_acceleration=2.0)))
    assert env.changes() == {
        'noise_std': 0.5,
        'world': {'n_sheep': 5, 'flock': {'model': 'reynolds', 'max_acceleration': 2.0}},
    }
    assert not world.equals({'n_sheep': 6})
    assert not world.equals({'n_sheep': 5, 'gone': 1})
    assert not world.equals('nonsense')


# ---- rows ----


def plain(table: pa.Table) -> list[dict[str, Any]]:
    """Return rows in an order that does not depend on keys."""
    rows = table.drop_columns(['key']).to_pylist()
    return sorted(rows, key=lambda row: (row['config'], row['checkpoint_sha256'], row['seed']))


@pytest.fixture(scope='module')
def stored() -> results.Results:
    """Return the rows of docs/results, whose keys are hashes of whole configurations."""
    return read_results([ROWS])


def test_rows_with_keys_of_whole_configurations_are_read_as_they_are(stored: Any) -> None:
    raw = parquet.read_table(ROWS)
    row = raw.slice(0, 1).to_pylist()[0]
    text = json.dumps([json.loads(row['config']), '', row['version']], sort_keys=True)
    assert row['key'] == hashlib.sha256(text.encode()).hexdigest()[:16], 'made by the old rule'
    table = read_results([ROWS]).table
    assert table.num_rows == raw.num_rows == 53_000
    for rows in (raw, table):  # the same episodes fall together under the new keys
        assert len(set(rows.column('key').to_pylist())) == 1010
    order = [('config', 'ascending'), ('checkpoint_sha256', 'ascending'), ('seed', 'ascending')]
    left, right = (t.drop_columns(['key']).sort_by(order) for t in (raw, table))
    for name in left.column_names:
        assert left.column(name).equals(right.column(name)), name


def test_an_experiment_finds_the_episodes_that_its_columns_name(stored: Any) -> None:
    samples = samples_of(stored, EXPERIMENTS['fig6'])
    assert samples is not None
    columns = stored.columns
    for place, setting in enumerate(samples.settings):
        mask = np.ones(len(stored), bool)
        for name in ('sheep', 'shepherds', 'flock', 'preset', 'noise', 'repulsion', 'start'):
            mask &= columns[name] == getattr(setting, name)
        for name in ('dropout', 'rays', 'cross_occlusion'):
            mask &= columns[name] == getattr(setting, name)
        for controller in samples.controllers:
            index = np.flatnonzero(mask & (columns['controller'] == controller))
            index = index[np.argsort(columns['seed'][index])][: len(samples.seeds)]
            assert np.array_equal(
                samples.values[controller, 'completion_time'][place],
                columns['completion_time'][index],
            )


def test_a_key_counts_what_differs_and_nothing_else() -> None:
    config = Cell(Setting(), 'pierson', 0, 1).config()
    key = cell_key(config, '', __version__)
    assert cell_key(without(config, 'shepherds_around'), '', __version__) == key
    assert cell_key(without(config, 'assignment'), '', __version__) == key
    seen = {key, cell_key(config, 'x', __version__), cell_key(config, '', '0.0')}
    for changed in (
        Cell(Setting(noise=0.1), 'pierson', 0, 1),
        Cell(Setting(rays=64), 'pierson', 0, 1),
        Cell(Setting(flock='reynolds'), 'pierson', 0, 1),
        Cell(Setting(), 'strombom', 0, 1),
    ):
        seen.add(cell_key(changed.config(), '', __version__))
    options = {'name': 'pierson', **PiersonConfig(lead=3.0).to_dict()}
    seen.add(cell_key(config | {'controller': options}, '', __version__))
    assert len(seen) == 8


def test_an_option_that_comes_later_changes_no_key_and_finds_the_old_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['evaluate', 'starts', *WORDS, '--out', str(tmp_path)]
    assert main(words) == 0
    before = read_results([tmp_path])
    wind, lure = with_option(EnvConfig), with_option(PiersonConfig, 'lure', 2)
    monkeypatch.setattr(results, 'EnvConfig', wind)
    monkeypatch.setattr('shepherd_ros.sim.rollout.EnvConfig', wind)
    monkeypatch.setattr(CONTROLLERS['pierson'], 'config_type', lure)
    results._stored_key.cache_clear()
    capsys.readouterr()
    assert main(words) == 0
    assert '12 episodes in 6 cells, 6 of them done' in capsys.readouterr().out
    after = read_results([tmp_path])
    assert after.table.equals(before.table)
    cell = Cell(Setting(sheep=3, steps=4), 'pierson', 0, 1)
    assert cell.config()['env']['wind'] == 0.0
    assert cell.config()['controller']['lure'] == 2
    assert cell_key(cell.config(), '', __version__) in before.seeds
    assert cell_key(cell.config() | {'env': {'wind': 0.1}}, '', __version__) not in before.seeds
    results._stored_key.cache_clear()


def test_evaluation_goes_on_over_rows_with_keys_of_the_version_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['evaluate', 'starts', *WORDS, '--out', str(tmp_path)]
    assert main(words) == 0
    whole = plain(results_in(tmp_path).table)
    for path in sorted(tmp_path.rglob('*.parquet')):  # as the version before named them
        table = parquet.read_table(path)
        row = table.slice(0, 1).to_pylist()[0]
        text = json.dumps([json.loads(row['config']), '', row['version']], sort_keys=True)
        old = hashlib.sha256(text.encode()).hexdigest()[:16]
        keys = pa.array([old] * len(table))
        write_rows(
            tmp_path / f'{row["controller"]}-{old}' / path.name,
            table.set_column(0, table.schema.field('key'), keys),
        )
        path.unlink()
    capsys.readouterr()
    assert main(words) == 0
    assert '6 of them done' in capsys.readouterr().out
    assert plain(results_in(tmp_path).table) == whole


def test_a_metric_that_was_not_counted_is_nan_and_unknown_columns_are_left_out(
    tmp_path: Path,
) -> None:
    table = cells.run_cell(Cell(Setting(sheep=3, steps=4), 'idle', 0, 2))
    table = table.drop_columns(['goal_distance', 'dropout'])
    write_rows(tmp_path / 'rows.parquet', table.append_column('later', pa.array([1.0, 2.0])))
    rows = read_results([tmp_path])
    assert rows.table.schema.names == schema().names
    assert np.isnan(rows.columns['goal_distance']).all()
    assert rows.columns['dropout'].tolist() == [0.0, 0.0]
    assert rows.columns['completion_time'].tolist() == table.column('completion_time').to_pylist()


def test_rows_of_what_is_not_known_here_are_kept_and_found_by_nothing(tmp_path: Path) -> None:
    table = cells.run_cell(Cell(Setting(sheep=3, steps=4), 'idle', 0, 1))
    config = json.loads(table.column('config')[0].as_py())
    config['env']['world']['flock'] = {'model': 'of a plug-in'}
    place = table.schema.get_field_index('config')
    changed = table.set_column(place, 'config', pa.array([json.dumps(config)]))
    write_rows(tmp_path / 'rows.parquet', changed)
    rows = read_results([tmp_path])
    assert rows.columns['key'].tolist() == table.column('key').to_pylist()
    assert not rows.in_environment(env_config(Setting(sheep=3))).any()


# ---- runs and episodes ----


def test_a_run_goes_on_after_an_option_was_added(tmp_path: Path) -> None:
    run = PPORunConfig(samples=300, ppo=PPOConfig(minibatch_size=16))
    requested = {'policy': PolicyConfig(), 'run': run, 'pretrained': ''}
    RunFolder(tmp_path, {'config': requested})
    file = tmp_path / 'run.json'
    data = json.loads(file.read_text())
    assert data['config']['run'] == run.to_dict()
    del data['config']['run']['task']['effort'], data['config']['policy']['network']['min_std']
    file.write_text(json.dumps(data))
    assert RunFolder(tmp_path, {'config': requested}).record['config']['run'] == run.to_dict()
    for other in (
        {'run': replace(run, task=TaskConfig(effort=0.1))},
        {'policy': PolicyConfig(network=NetworkConfig(hidden=8))},
        {'pretrained': 'imitation'},
    ):
        with pytest.raises(ConfigError, match='holds a run with another configuration'):
            RunFolder(tmp_path, {'config': requested | other})


def test_an_episode_that_was_described_before_an_option_came_has_its_default() -> None:
    world = WorldConfig(n_sheep=5)
    old = world.to_dict()
    del old['shepherd_speed'], old['spawn']['flock_groups']
    episode = Episode(0, 1, 0, 5, 3, 4.0, 'map', 'lockstep', old)
    assert world.equals(Episode.from_json(episode.to_json()).world)
    assert not replace(world, shepherd_speed=2.0).equals(old)


def test_a_world_parameter_of_a_plug_in_counts_only_where_it_is_not_its_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key = cell_key(Cell(Setting(), 'idle', 0, 1).config(), '', __version__)
    assert main(['record', '--out', str(tmp_path), '--controller', 'idle', '--episodes', '1',
                 '--sheep', '3', '--steps', '4']) == 0  # fmt: skip
    wind = WorldParameter('wind', 0.0, 'drift [m/s]', lambda before, after, value, dt: after)
    monkeypatch.setitem(WORLD_PARAMETERS._entries, 'wind', wind)
    assert cell_key(Cell(Setting(), 'idle', 0, 1).config(), '', __version__) == key
    still = Setting(set=('world.wind=0',))
    assert cell_key(Cell(still, 'idle', 0, 1).config(), '', __version__) == key
    blown = Setting(set=('world.wind=0.5',))
    assert env_config(blown).world.changes()['wind'] == 0.5
    assert cell_key(Cell(blown, 'idle', 0, 1).config(), '', __version__) != key
    assert check_bag(open_bag(next(tmp_path.glob('e*')))).ok
    with pytest.raises(ConfigError, match=r"no option 'world.wnid'; did you mean 'world.wind'\?"):
        env_config(Setting(set=('world.wnid=0.5',)))
