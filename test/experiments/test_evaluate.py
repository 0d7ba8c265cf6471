"""Whole episodes of controllers, and the verb that makes rows of them."""

from dataclasses import replace
import json
from pathlib import Path
import subprocess

import numpy as np
import pytest
from shepherd_ros import __version__
from shepherd_ros.cli import evaluate_verb, main
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers import make_controller
from shepherd_ros.controllers.composite import CompositeController
from shepherd_ros.experiments import campaign
from shepherd_ros.experiments.campaign import plan, seed_batches, shard_of
from shepherd_ros.experiments.catalog import EXPERIMENTS, experiments
from shepherd_ros.experiments.cells import Cell, run_cell
from shepherd_ros.experiments.methods import (
    checkpoint_hash,
    checkpoint_of,
    full_name,
    make_method,
    timing_note,
)
from shepherd_ros.experiments.results import read_results, value_names
from shepherd_ros.experiments.runner import run_episodes
from shepherd_ros.experiments.samples import Samples
from shepherd_ros.experiments.setting import (
    canonical_setting,
    describe_setting,
    env_config,
    Setting,
)
from shepherd_ros.paper import stopping
from shepherd_ros.paper.claims import finding_of, Sweep
from shepherd_ros.paper.statements import CLAIMS
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.world import WorldConfig
import torch

TINY = Setting(sheep=4, shepherds=2, steps=6)
WORDS = ['--sheep', '4', '--steps', '6', '--episodes', '3']


@pytest.mark.system
@pytest.mark.parametrize(('name', 'least'), [('strombom', 0.95), ('pierson', 0.99)])
def test_a_heuristic_brings_the_flock_home_on_the_default_world(name: str, least: float) -> None:
    world = WorldConfig()
    result = run_episodes(EnvConfig(world=world), make_controller(name, world), 0, 24)
    assert float(result['fraction_reached'].mean()) >= least
    assert bool(result['completed'].all())


@pytest.mark.parametrize('name', ['idle', 'random'])
def test_a_floor_brings_nobody_home(name: str) -> None:
    world = replace(WorldConfig(), episode_steps=200)
    result = run_episodes(EnvConfig(world=world), make_controller(name, world), 0, 8)
    assert float(result['fraction_reached'].mean()) < 0.3


def test_an_episode_is_the_same_alone_and_among_others() -> None:
    config = EnvConfig(world=replace(WorldConfig(), n_sheep=20, episode_steps=120))
    controller = make_controller('strombom', config.world)
    together = run_episodes(config, controller, 5, 3)
    for k in range(3):
        alone = run_episodes(config, controller, 5 + k, 1)
        for name, values in together.items():
            torch.testing.assert_close(alone[name][0], values[k], atol=1e-5, rtol=1e-5)


# ---- settings and cells ----


def test_experiments_have_the_settings_of_section_10() -> None:
    fixed = Setting()
    assert (fixed.sheep, fixed.shepherds, fixed.steps, fixed.flock) == (100, 3, 1000, 'strombom')
    found = {name: EXPERIMENTS[name] for name in ('fig4', 'fig5', 'fig6', 'fig7', 'fig8')}
    values = {name: e.settings for name, e in found.items()}
    assert [s.sheep for s in values['fig4']] == list(range(10, 101, 10))
    assert [s.shepherds for s in values['fig5']] == [1, 2, 3, 4, 5, 6]
    assert [s.noise for s in values['fig6']] == pytest.approx([k * 0.2 for k in range(11)])
    assert [s.repulsion for s in values['fig7']] == [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0]
    assert {s.flock for s in values['fig8']} == {'reynolds'}
    for e in EXPERIMENTS.values():
        for setting in (*e.settings, *e.quick):
            config = env_config(setting)
            assert config.world.goal_radius == 4.0 or setting.set or setting.task == 'protection'
            assert config.noise_std == setting.noise
    assert [e.name for e in experiments(['4', 'fig5', '4'])] == ['fig4', 'fig5']
    assert {'fig4', 'fractions', 'fig8'} <= {e.name for e in experiments(['paper'])}


def test_a_setting_says_in_what_it_differs_from_the_paper() -> None:
    assert describe_setting(canonical_setting(Setting())) == 'default setting'
    assert describe_setting(canonical_setting(Setting(sheep=10, rays=64))) == '10 sheep, 64 rays'
    assert describe_setting(canonical_setting(Setting(preset='rho_a_one'))) == 'preset rho_a_one'
    assert env_config(Setting(start='two_groups')).world.spawn.flock_groups == 2


def test_equal_settings_of_two_experiments_are_one_cell() -> None:
    both = plan([Setting(), Setting(repulsion=2.0)], ['idle'], 0, 10)
    assert len(both) == 1
    assert len({task.key for task in plan([Setting(), Setting(noise=1.0)], ['idle'], 0, 1)}) == 2
    assert len({t.key for t in plan([Setting()], ['idle', 'random', 'policy'], 0, 1)}) == 3


def test_batches_of_seeds_are_cut_at_the_same_places_whatever_the_number() -> None:
    assert list(seed_batches(0, 105)) == [(0, 50), (50, 50), (100, 5)]
    assert list(seed_batches(7, 50)) == [(7, 50)]


def test_shards_share_the_cells_and_leave_none_out() -> None:
    tasks = plan([Setting(), Setting(noise=1.0)], ['idle', 'random'], 0, 50)
    parts = [shard_of(tasks, f'{i}/3') for i in (1, 2, 3)]
    assert sorted(t.key for part in parts for t in part) == sorted(t.key for t in tasks)


def test_a_row_says_everything_about_its_episode() -> None:
    setting = replace(TINY, noise=0.5)
    table = run_cell(Cell(setting, 'policy:imitation', 5, 2), 'abc').to_pylist()
    assert [row['seed'] for row in table] == [5, 6]
    config = json.loads(table[0]['config'])
    assert config['env'] == env_config(setting).to_dict()
    assert config['controller']['checkpoint'] == 'imitation'
    assert table[0]['checkpoint_sha256'] == checkpoint_hash('policy:imitation')
    assert len(table[0]['checkpoint_sha256']) == 64
    assert (table[0]['version'], table[0]['code']) == (__version__, 'abc')
    controller = make_method('policy:imitation', setting)
    expected = run_episodes(env_config(setting), controller, 5, 2)
    assert [row['shepherd_path_length'] for row in table] == [
        float(x) for x in expected['shepherd_path_length']
    ]


def test_faults_reach_the_lidar_of_a_policy_and_fewer_rays_stand_for_their_neighbours() -> None:
    whole = make_method('policy:imitation', TINY)
    blind = make_method('policy:imitation', replace(TINY, dropout=1.0))
    coarse = make_method('policy:imitation', replace(TINY, rays=64))
    state = run_state()
    assert whole.read_ranges(state).isfinite().any()
    assert not blind.read_ranges(state).isfinite().any()
    fine, seen = whole.read_ranges(state), coarse.read_ranges(state)
    assert seen.shape == fine.shape
    assert torch.equal(seen[..., ::8], fine[..., ::8])  # rays in common
    assert torch.equal(seen[..., 1:4], seen[..., :1].expand(*seen.shape[:-1], 3))
    assert torch.equal(seen[..., -4:], seen[..., :1].expand(*seen.shape[:-1], 4))


def run_state() -> object:
    from shepherd_ros.sim.spawn import spawn

    return spawn(env_config(TINY).world, torch.tensor([3]))


def test_a_spread_of_samples_is_part_of_a_policys_name_and_of_its_rows() -> None:
    assert full_name('policy:general@0.080') == 'policy:general@0.08'
    assert full_name('policy:@0.5') == 'policy:general@0.5'
    assert full_name('policy:general@0') == 'policy:general@0'
    assert checkpoint_of('policy:general@0.08') == 'general'
    assert checkpoint_of('policy:a@b/c.safetensors') == 'a@b/c.safetensors'
    assert checkpoint_hash('policy:general@0.08') == checkpoint_hash('policy:general')
    with pytest.raises(ConfigError, match=r'sample_std is -2\.0'):
        make_method('policy:general@-2', Setting())
    mean, drawn = (run_cell(Cell(TINY, f'policy:imitation{x}', 0, 1)) for x in ('', '@0.3'))
    assert drawn['controller'].to_pylist() == ['policy:imitation@0.3']
    stored = json.loads(drawn['config'][0].as_py())['controller']
    assert (stored['checkpoint'], stored['sample_std']) == ('imitation', 0.3)
    assert drawn['key'] != mean['key']
    assert drawn['shepherd_path_length'] != mean['shepherd_path_length']
    again = run_cell(Cell(TINY, 'policy:imitation@0.3', 0, 1))
    assert again.equals(drawn)


def test_a_policy_drives_at_any_time_step_and_says_which_times_it_uses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert timing_note('policy:imitation', 0.5) == timing_note('policy:imitation', 0.1) == ''
    assert timing_note('drover', 0.2) == ''
    note = 'policy:imitation decides every 1 s instead of 0.5 s, as a step takes 1 s'
    assert timing_note('policy:imitation', 1.0) == note
    words = ['evaluate', 'table', *WORDS, '--controllers', 'policy:imitation', 'idle']
    assert main([*words, '--set', 'world.dt=1.0', '--out', str(tmp_path)]) == 0
    assert capsys.readouterr().out.count(note) == 1


# ---- the verb ----


def test_the_verb_writes_rows_and_a_table_and_does_nothing_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'new' / 'rows'
    words = ['evaluate', 'table', '--shepherds', '1', '2', *WORDS, '--out', str(out)]
    words += ['--controllers', 'strombom', 'idle']
    assert main(words) == 0
    rows = read_results([out])
    assert len(rows) == 2 * 2 * 3
    assert '12 episodes in 4 cells, 0 of them done' in capsys.readouterr().out
    lines = (out / 'table.md').read_text().splitlines()
    assert len(lines) == 2 + 4
    assert lines[2].startswith('| 1 | Strömbom | 6 [6, 6] |')
    written = {path: path.stat().st_mtime_ns for path in out.rglob('*.parquet')}
    assert main(words) == 0
    assert '4 of them done' in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in out.rglob('*.parquet')} == written


def test_rows_of_other_code_are_kept_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['evaluate', 'table', '--shepherds', '1', '2', *WORDS, '--out', str(tmp_path)]
    monkeypatch.setattr(evaluate_verb, 'commit', lambda: 'older')
    assert main([*words, '--controllers', 'idle']) == 0
    assert main([*words, '--controllers', 'idle']) == 0
    assert 'other code' not in capsys.readouterr().out
    monkeypatch.setattr(evaluate_verb, 'commit', lambda: 'newer')
    assert main([*words, '--controllers', 'idle', 'random']) == 0
    output = ' '.join(capsys.readouterr().out.split())
    assert 'done by other code: older; this is newer, give another --out' in output
    assert read_results([tmp_path]).distinct('code') == ['newer', 'older']


def test_a_run_that_was_killed_goes_on_and_ends_with_the_same_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ['evaluate', '4', *WORDS[2:], '--sheep', '3', '--controllers', 'strombom', 'random']
    words += ['--shepherds', '1', '2', '3', '--episodes', '60']
    whole, cut = tmp_path / 'whole', tmp_path / 'cut'
    assert main([*words, '--out', str(whole)]) == 0

    done = []

    def killed(folder: Path, cell: Cell, key: str, code: str) -> Cell:
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(cell)
        return run(folder, cell, key, code)

    run = campaign.run_into
    monkeypatch.setattr(campaign, 'run_into', killed)
    assert main([*words, '--out', str(cut)]) == 130
    assert len(list(cut.rglob('*.parquet'))) == 3
    (next(cut.rglob('*.parquet')).parent / '.000000-000019.parquet.part').write_bytes(b'torn')
    monkeypatch.setattr(campaign, 'run_into', run)
    assert main([*words, '--out', str(cut)]) == 0
    left, right = (read_results([folder]).table for folder in (whole, cut))
    assert left.equals(right)
    assert left.num_rows == 3 * 2 * 60


def test_policies_take_the_place_of_the_policy_of_an_experiment(tmp_path: Path) -> None:
    words = ['evaluate', 'starts', '--sheep', '3', '--steps', '2', '--episodes', '1']
    words += ['--policies', 'policy:imitation', 'idle', '--out', str(tmp_path)]
    assert main(words) == 0
    drove = read_results([tmp_path]).distinct('controller')
    assert drove == ['drover', 'idle', 'pierson', 'policy:imitation', 'strombom']


def test_a_primary_policy_drives_the_flock_of_its_training(tmp_path: Path) -> None:
    words = ['evaluate', '4', '8', '--sheep', '3', '--steps', '2', '--episodes', '1']
    words += ['--controllers', 'policy', 'idle', '--out', str(tmp_path)]
    assert main([*words, '--primary', 'policy:paper_network', 'policy:reynolds']) == 0
    rows = read_results([tmp_path])
    drove = set(zip(rows.columns['controller'], rows.columns['flock'], strict=True))
    assert drove == {
        ('policy:paper_network', 'strombom'), ('policy:reynolds', 'reynolds'),
        ('idle', 'strombom'), ('idle', 'reynolds'),
    }  # fmt: skip


def test_a_primary_policy_may_fly_in_a_preset_without_one(tmp_path: Path) -> None:
    words = ['evaluate', '4', '--sheep', '3', '--steps', '2', '--episodes', '1']
    words += ['--preset', 'table_literal', '--controllers', 'policy', '--out', str(tmp_path)]
    assert main([*words, '--primary', 'policy:paper_network']) == 0
    assert read_results([tmp_path]).distinct('preset') == ['table_literal']


def test_a_figure_ends_early_once_its_verdicts_are_certain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ['evaluate', '4', '5', '--sheep', '3', '--steps', '2', '--controllers', 'idle']
    words += ['--stop-early', '--episodes', '120', '--out', str(tmp_path)]
    requested: list[tuple[str, int]] = []

    def certain(samples: Samples, primary: str) -> bool:
        requested.append((samples.experiment.name, len(samples.seeds)))
        return samples.experiment.name == 'fig4'

    monkeypatch.setattr(stopping, 'is_certain', certain)
    assert main(words) == 0
    assert requested == [('fig4', 50), ('fig5', 50), ('fig5', 100)]
    rows = read_results([tmp_path])
    teams = rows.columns['shepherds']
    assert {int(m): int((teams == m).sum()) for m in set(teams)} == dict.fromkeys(range(1, 7), 120)
    output = capsys.readouterr().out
    assert 'fig4: all verdicts are certain after 50 episodes' in output
    assert 'all episodes would be about' in output
    assert (tmp_path / 'fig4.md').exists()
    assert main([*words, '--shard', '1/2']) == 2
    assert 'expected no --shard' in capsys.readouterr().err


def test_the_short_form_has_the_points_of_all_statements() -> None:
    for name in ('fig4', 'fig5', 'fig6', 'fig7', 'fig8', 'fractions'):
        quick, whole = EXPERIMENTS[name].quick, EXPERIMENTS[name].settings
        assert set(quick) < set(whole)
        settings = tuple(dict.fromkeys(map(canonical_setting, quick)))
        ones = {
            (who, metric): np.ones((len(settings), 2))
            for who in ('policy:x', 'strombom', 'pierson') for metric in value_names()
        }  # fmt: skip
        samples = Samples(EXPERIMENTS[name], settings, (0, 1), 1000, ones)
        for claim in CLAIMS:
            for clause in claim.clauses:
                if claim.experiment == name:
                    assert not finding_of(clause, Sweep(samples, 'policy:x')).reason, clause.text


def test_more_episodes_take_the_place_of_fewer(tmp_path: Path) -> None:
    words = ['evaluate', '4', '--sheep', '3', '--steps', '4', '--controllers', 'idle']
    words += ['--out', str(tmp_path)]
    assert main([*words, '--episodes', '2']) == 0
    assert main([*words, '--episodes', '70']) == 0
    assert sorted(p.name for p in tmp_path.rglob('*.parquet')) == [
        '000000-000049.parquet',
        '000050-000069.parquet',
    ]
    assert read_results([tmp_path]).distinct('seed') == list(range(70))


def test_shards_on_two_machines_make_the_rows_of_one(tmp_path: Path) -> None:
    words = ['evaluate', '6', *WORDS, '--controllers', 'pierson']
    assert main([*words, '--out', str(tmp_path / 'one')]) == 0
    for i in (1, 2):
        assert main([*words, '--shard', f'{i}/2', '--out', str(tmp_path / 'two')]) == 0
    one, two = (read_results([tmp_path / name]).table for name in ('one', 'two'))
    assert one.equals(two)


@pytest.mark.system
def test_two_ranks_of_torchrun_make_the_rows_of_one_process(
    commands: Path, tmp_path: Path
) -> None:
    words = ['evaluate', '6', *WORDS, '--controllers', 'pierson', '--out']
    assert main([*words, str(tmp_path / 'one')]) == 0
    launch = [
        '-m',
        'torch.distributed.run',
        '--standalone',
        '--nproc-per-node',
        '2',
        '--no-python',
    ]
    command = [commands / 'python', *launch, commands / 'shepherd', *words, tmp_path / 'two']
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    one, two = (read_results([tmp_path / name]).table for name in ('one', 'two'))
    assert one.equals(two)
    assert done.stdout.count('fig6.md') == 1, 'the table is written once, when all is there'


@pytest.mark.system
def test_cells_run_in_processes_too(tmp_path: Path) -> None:
    words = ['evaluate', '5', '--steps', '3', '--sheep', '3', '--episodes', '1', '--workers', '2']
    assert main([*words, '--controllers', 'idle', '--out', str(tmp_path)]) == 0
    assert len(read_results([tmp_path])) == 6


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['9'], "experiment is '9': expected one of fig4"),
        (['tabel'], "did you mean 'table'"),
        (['4', '--controllers', 'dog'], "controller is 'dog': expected one of"),
        (
            ['4', '--controllers', 'pierson:x'],
            'expected pierson alone; a colon follows only c',
        ),
        (['4', '--controllers', 'policy:none'], "checkpoint is 'none': expected a .safetensors"),
        (['4', '--episodes', '0'], '--episodes is 0: expected at least 1'),
        (['4', '--workers', '0'], '--workers is 0: expected at least 1'),
        (['4', '--steps', '0'], 'episode_steps is 0: expected a value in'),
        (['4', '--set', 'world.dtt=1'], "no option 'world.dtt'; did you mean 'world.dt'?"),
        (['4', '--shard', '3/2'], "--shard is '3/2': expected i/n"),
        (['4', '--shard', 'half'], "--shard is 'half': expected i/n"),
        (['4', '--shepherds', '0'], 'shepherds is 0: expected a value in'),
        (['4', '--preset', 'papr'], "preset is 'papr'"),
        (['7', '--flock', 'reynolds'], 'the reynolds flock has no rho_a'),
    ],
)
def test_a_mistake_is_named_before_anything_runs(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['evaluate', *words, '--out', str(tmp_path / 'x')]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / 'x').exists()


def test_names_of_methods_are_whole() -> None:
    assert full_name('policy') == 'policy:general'
    assert full_name('drover') == 'drover'
    assert full_name('composite:policy,drover') == 'composite:policy:general,drover'
    assert full_name('composite:idle,policy,1,2') == 'composite:idle,policy:general,1,2'
    for wrong in ('composite:idle,nobody', 'composite:policy:nowhere,idle'):
        with pytest.raises(ConfigError, match=r'nobody|nowhere'):
            full_name(wrong)


def test_a_composite_is_known_by_the_files_of_its_policies() -> None:
    files = [checkpoint_hash(f'policy:{name}') for name in ('imitation', 'general')]
    assert checkpoint_hash('composite:policy:imitation,drover') == files[0]
    assert checkpoint_hash('composite:policy:imitation,policy:general') == '+'.join(files)
    assert checkpoint_hash('composite:idle,drover') == checkpoint_hash('composite') == ''
    setting = replace(TINY, preset='paper')
    law = make_method('composite:strombom,pierson,0.5,1', setting)
    assert isinstance(law, CompositeController)
    assert (law.config.home_within, law.config.away_beyond) == (0.5, 1.0)
    for part in (law.drive, law.hold):
        assert part.config == make_method(part.name, setting).config
