"""Aggregation, intervals and verdicts on numbers that are worked out by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet
import pytest
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.bootstrap import mean_interval, resampled
from shepherd_ros.experiments.catalog import EXPERIMENTS
from shepherd_ros.experiments.results import (
    read_results,
    Results,
    schema,
    table_of,
    value_names,
    write_rows,
)
from shepherd_ros.experiments.samples import Samples, samples_of
from shepherd_ros.experiments.setting import canonical_setting, env_config, Setting
from shepherd_ros.experiments.table import grid, grids, interval_text, markdown
from shepherd_ros.experiments.value_map import has_critic, places, value_map, ValueMap
from shepherd_ros.paper.claims import (
    ABOVE,
    AGREES,
    BELOW,
    BETTER,
    Clause,
    ClauseFinding,
    combined_verdict,
    DISAGREES,
    finding_of,
    strict_verdict,
    Sweep,
    UNDECIDED,
    verdict,
)
from shepherd_ros.paper.curves import Curve, curve_verdict, find_curves, smoothed
from shepherd_ros.paper.primary import primary_policies, trained_on
from shepherd_ros.paper.quantities import below, change, ratio, slope
from shepherd_ros.paper.statements import CLAIMS
from shepherd_ros.paper.stopping import is_certain
from shepherd_ros.paper.value_verdicts import AREAS, BEHIND, verdicts_on_values
from shepherd_ros.paper.verdict_tables import counts_by_figure
from shepherd_ros.paper.verdicts import (
    bare_clause,
    counts,
    Verdict,
    verdicts_on_curves,
    verdicts_on_samples,
)
from shepherd_ros.policy.checkpoint import save_policy
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.metrics import count_step, metrics, start_tally
from shepherd_ros.sim.spawn import spawn
import torch

POLICY = 'policy:imitation'


def made_up(setting: Setting, controller: str, **values: Any) -> pa.Table:
    """Return rows of a cell, one for each of the values of a metric."""
    count = len(next(iter(values.values())))
    constants = canonical_setting(setting).to_dict() | {
        'key': f'{controller} {setting}', 'controller': controller,
        'config': json.dumps({'env': env_config(setting).to_dict()}),
        'checkpoint_sha256': '', 'version': '1', 'code': '',
    }  # fmt: skip
    columns = {name: [0.0] * count for name in value_names()} | values
    columns['seed'] = list(range(count))
    return table_of(constants, columns)


def figure(name: str, **curves: Any) -> Samples:
    """Return samples of a figure; controller_metric=means over its axis, with two episodes."""
    experiment = EXPERIMENTS[name]
    tables = []
    for controller in (POLICY, 'strombom', 'pierson'):
        own = {
            full[len(short) + 1 :]: mean
            for full, mean in curves.items()
            for short in [{POLICY: 'rl'}.get(controller, controller)]
            if full.startswith(short + '_')
        }
        for k, setting in enumerate(experiment.settings if own else ()):
            values = {metric: [0.99 * mean[k], 1.01 * mean[k]] for metric, mean in own.items()}
            tables.append(made_up(setting, controller, **values))
    found = samples_of(Results(pa.concat_tables(tables)), experiment)
    assert found is not None
    return found


# ---- a trajectory by hand ----


def test_a_trajectory_is_counted_as_it_is_by_hand() -> None:
    world = env_config(Setting(sheep=2, shepherds=2)).world
    start = spawn(world, torch.tensor(0))

    def state(step: int, sheep: list[list[float]], shepherds: list[list[float]]) -> Any:
        return replace(
            start,
            step=torch.tensor(step),
            sheep=torch.tensor(sheep),
            shepherds=torch.tensor(shepherds),
        )

    # goal of 4 m at the origin; the center comes home at step 2, when one sheep is inside
    states = [
        state(0, [[10.0, 3.0], [10.0, -3.0]], [[20.0, 0.0], [20.0, 5.0]]),
        state(1, [[6.0, 3.0], [6.0, -3.0]], [[17.0, 0.0], [20.0, 4.0]]),
        state(2, [[2.0, 3.0], [2.0, -4.0]], [[17.0, 4.0], [20.0, 4.0]]),
        state(3, [[2.0, 3.0], [2.0, -4.0]], [[17.0, 14.0], [20.0, 4.0]]),
    ]
    tally = start_tally(states[0])
    for before, after in pairwise(states):
        tally = count_step(tally, before, after)
    result = {name: float(value) for name, value in metrics(tally, states[-1], 1000).items()}
    assert result['completion_time'] == 2
    assert result['shepherd_path_length'] == (3 + 4 + 10 + 1) / 2
    assert result['shepherd_path_to_completion'] == (3 + 4 + 1) / 2
    assert result['flock_path_length'] == pytest.approx(4 + math.hypot(4, 0.5))
    assert result['flock_spread'] == pytest.approx((3 + 3.5 + 3.5) / 3)
    assert result['fraction_reached'] == 0.5


def test_means_of_a_cell_and_their_interval_are_those_by_hand() -> None:
    table = made_up(Setting(sheep=10), 'pierson', completion_time=[10.0, 20.0, 30.0, 40.0])
    samples = samples_of(Results(table), EXPERIMENTS['fig4'])
    assert samples is not None
    assert samples.values['pierson', 'completion_time'].tolist() == [[10, 20, 30, 40]]
    assert '| 10 | Pierson | 25 [15, 35] |' in markdown(samples)


def test_a_grid_has_flocks_and_controllers_down_and_teams_across() -> None:
    cells = {(50, 1, 'pierson'): 20.0, (50, 3, 'pierson'): 30.0, (50, 3, 'idle'): 40.0}
    tables = [
        made_up(Setting(sheep=n, shepherds=m), who, completion_time=[value] * 4)
        for (n, m, who), value in cells.items()
    ]
    samples = samples_of(Results(pa.concat_tables(tables)), EXPERIMENTS['table'])
    assert samples is not None
    lines = grid(samples, 'completion_time').splitlines()
    assert lines[0] == '| sheep | controller | M = 1 | M = 3 |'
    assert lines[2:] == [
        '| 50 | Pierson | 20 [20, 20] | 30 [30, 30] |',
        '| 50 | idle |  | 40 [40, 40] |',
    ]
    assert grid(samples, 'completion_time') in grids(samples)


def test_an_episode_that_is_there_twice_counts_once_and_cells_share_their_seeds() -> None:
    many = made_up(Setting(sheep=10), 'pierson', completion_time=[1.0, 2.0, 3.0])
    few = made_up(Setting(sheep=20), 'pierson', completion_time=[5.0, 6.0])
    rows = Results(pa.concat_tables([many, few, many]))
    assert len(rows) == 5
    samples = samples_of(rows, EXPERIMENTS['fig4'])
    assert samples is not None
    assert samples.seeds == (0, 1)
    assert samples.values['pierson', 'completion_time'].tolist() == [[1, 2], [5, 6]]


def test_a_controller_with_less_than_half_of_the_episodes_is_left_out() -> None:
    def cells(who: str, sheep: range, times: Sequence[float] = (1.0, 2.0, 3.0)) -> list[pa.Table]:
        return [made_up(Setting(sheep=n), who, completion_time=list(times)) for n in sheep]

    tables = [
        *cells('pierson', range(10, 101, 10)),
        *cells('drover', range(10, 51, 10)),
        *cells('strombom', range(10, 41, 10)),
        *cells('policy:strombom', range(10, 101, 10), times=(1.0,)),  # all settings, a third
    ]
    samples = samples_of(Results(pa.concat_tables(tables)), EXPERIMENTS['fig4'])
    assert samples is not None
    assert sorted(samples.controllers) == ['drover', 'pierson']
    assert sorted(samples.left_out) == ['policy:strombom', 'strombom']
    assert samples.seeds == (0, 1, 2)
    assert len(samples.notes) == 2
    assert 'fig4 is without policy:strombom' in samples.notes[0]


def test_a_controller_with_other_seeds_is_left_out() -> None:
    cells = [made_up(Setting(sheep=n), 'pierson', completion_time=[1.0, 2.0]) for n in (10, 20)]
    other = made_up(Setting(sheep=10), 'drover', completion_time=[3.0, 4.0])
    seed = other.schema.get_field_index('seed')
    other = other.set_column(seed, other.schema.field(seed), pa.array([7, 8]))
    samples = samples_of(Results(pa.concat_tables([*cells, other])), EXPERIMENTS['fig4'])
    assert samples is not None
    assert samples.controllers == ['pierson']
    assert samples.left_out == ('drover',)


def test_rows_of_the_same_world_count_whatever_its_setting_is_called() -> None:
    named, changed = Setting(preset='rho_a_one'), Setting(repulsion=1.0)
    assert env_config(named) == env_config(changed)
    rows = made_up(changed, 'pierson', completion_time=[5.0, 7.0])
    text = json.dumps({'env': env_config(canonical_setting(changed)).to_dict()})
    config = rows.schema.get_field_index('config')
    rows = rows.set_column(config, rows.schema.field(config), pa.array([text] * len(rows)))
    sweep = replace(EXPERIMENTS['starts'], settings=(named,))
    found = samples_of(Results(rows), sweep)
    assert found is not None
    assert found.values['pierson', 'completion_time'].tolist() == [[5.0, 7.0]]
    other = replace(sweep, settings=(Setting(repulsion=1.5),))
    assert samples_of(Results(rows), other) is None


def test_of_a_sweep_only_controllers_of_which_all_is_there_are_drawn() -> None:
    sweep = EXPERIMENTS['starts']
    first, *others = map(canonical_setting, sweep.settings)

    def rows(*tables: pa.Table) -> Results:
        return Results(pa.concat_tables(tables))

    whole = [made_up(s, 'pierson', completion_time=[1.0, 2.0]) for s in (first, *others)]
    alone = made_up(first, 'strombom', completion_time=[1.0, 2.0])
    cut = [made_up(s, 'drover', completion_time=[1.0, 2.0]) for s in others]
    cut.append(made_up(first, 'drover', completion_time=[1.0]))
    found = samples_of(rows(*whole, alone, *cut), sweep, whole=True)
    assert found is not None
    assert found.controllers == ['pierson']
    assert found.seeds == (0, 1)
    assert samples_of(rows(alone), sweep, least=2, whole=True) is None
    short = [made_up(canonical_setting(s), 'pierson', completion_time=[1.0]) for s in sweep.quick]
    quick = samples_of(rows(*short), sweep, whole=True)
    assert quick is not None
    assert len(quick.settings) == len(sweep.quick) < len(sweep.settings)


# ---- intervals ----


def test_the_bootstrap_interval_of_many_normal_numbers_is_the_normal_one() -> None:
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    mean, low, high = mean_interval(values)
    half = 1.96 * values.std() / 20
    assert mean == values.mean()
    assert low == pytest.approx(mean - half, abs=0.02)
    assert high == pytest.approx(mean + half, abs=0.02)


def test_the_bootstrap_interval_of_zero_and_one_is_all_of_it() -> None:
    # of two draws out of {0, 1} the mean is 0 or 1 with a chance of one quarter each
    mean, low, high = mean_interval(np.array([0.0, 1.0]))
    assert (mean, low, high) == (0.5, 0.0, 1.0)


def test_the_same_episodes_are_drawn_every_time_and_one_alone_has_no_interval() -> None:
    assert np.array_equal(resampled(7), resampled(7))
    mean, low, high = mean_interval(np.array([3.0]))
    assert mean == 3.0
    assert math.isnan(low)
    assert math.isnan(high)
    assert interval_text(3.0, 2.5, 123.4) == '3 [2.5, 123]'


# ---- the rule ----


@pytest.mark.parametrize(
    ('low', 'high', 'expected'),
    [
        (1.1, 1.9, AGREES),
        (1.0, 2.0, AGREES),
        (0.5, 0.9, DISAGREES),
        (2.1, 3.0, DISAGREES),
        (0.9, 1.5, UNDECIDED),
        (0.5, 3.0, UNDECIDED),
        (math.nan, math.nan, UNDECIDED),
        (1.5, math.inf, UNDECIDED),
    ],
)
def test_an_interval_is_held_against_bounds(low: float, high: float, expected: str) -> None:
    assert strict_verdict(low, high, 1.0, 2.0) == expected
    assert verdict(low, high, 1.0, 2.0) == expected


@pytest.mark.parametrize(
    ('low', 'high', 'lower', 'upper', 'expected'),
    [
        (1.1, 1.9, 1.0, 2.0, AGREES),
        (2.1, 3.0, 1.0, 2.0, BETTER),
        (0.5, 0.9, 1.0, 2.0, DISAGREES),
        (1.5, 2.5, 1.0, 2.0, AGREES),  # crosses only the bound to the better side
        (1.0, 9.0, 1.0, 2.0, AGREES),
        (0.9, 1.5, 1.0, 2.0, UNDECIDED),
        (0.9, 2.5, 1.0, 2.0, UNDECIDED),
        (1.1, 1.2, -math.inf, 1.0, BETTER),  # the other way round, and better so
        (0.9, 1.1, -math.inf, 1.0, UNDECIDED),
        (0.8, 0.9, -math.inf, 1.0, AGREES),
        (math.nan, math.nan, 1.0, 2.0, UNDECIDED),
        (2.5, math.inf, 1.0, 2.0, UNDECIDED),
    ],
)
def test_a_number_on_the_better_side_of_its_bounds_is_better(
    low: float, high: float, lower: float, upper: float, expected: str
) -> None:
    assert verdict(low, high, lower, upper, ABOVE) == expected
    assert verdict(-high, -low, -upper, -lower, BELOW) == expected


def test_nothing_is_better_where_the_policy_leaves_sheep_behind() -> None:
    clause = Clause('', ratio('pierson', 'RL', 'shepherd_path_length'), 3.0, 5.0, ABOVE)
    paths = {'rl_shepherd_path_length': [1.0] * 6, 'pierson_shepherd_path_length': [9.0] * 6}
    for last, expected in ((0.95, BETTER), (0.85, DISAGREES)):
        samples = figure('fig5', rl_fraction_reached=[1.0] * 5 + [last], **paths)
        found = finding_of(clause, Sweep(samples, POLICY))
        assert (found.verdict, found.strict) == (expected, DISAGREES)
        assert ('no better' in found.reason) == (expected == DISAGREES)
    # where the number does not look, nothing is asked
    first = Clause('', change('RL', 'shepherd_path_length', 1, 2), high=0.5, better=ABOVE)
    samples = figure('fig5', rl_fraction_reached=[1.0] * 5 + [0.2], **paths)
    assert finding_of(first, Sweep(samples, POLICY)).verdict == BETTER


def test_better_is_said_of_numbers_with_the_policy_or_of_more_sheep_at_home() -> None:
    samples = {
        name: figure(name, **{
            f'{who}_{metric}': np.ones(len(EXPERIMENTS[name].settings))
            for who in ('rl', 'strombom', 'pierson') for metric in value_names()
        })
        for name in ('fig4', 'fig5', 'fig6', 'fig7', 'fig8', 'fractions')
    }  # fmt: skip
    marked = 0
    for claim in CLAIMS:
        for clause in claim.clauses:
            sweep = Sweep(samples[claim.experiment], POLICY)
            finding_of(clause, sweep)
            if clause.better:
                marked += 1
                with_policy = any(method == 'RL' for method, _ in sweep.used_means)
                assert with_policy or {m for _, m in sweep.used_means} == {'fraction_reached'}
    assert marked == 15


def test_a_statement_holds_if_all_its_numbers_do() -> None:
    assert combined_verdict([AGREES, BETTER]) == BETTER
    assert combined_verdict([BETTER, UNDECIDED]) == UNDECIDED
    assert combined_verdict([BETTER, DISAGREES]) == DISAGREES
    assert combined_verdict([AGREES, AGREES]) == AGREES
    assert combined_verdict([AGREES, UNDECIDED]) == UNDECIDED
    assert combined_verdict([UNDECIDED, DISAGREES, AGREES]) == DISAGREES
    assert combined_verdict([]) == UNDECIDED


def test_quantities_of_made_up_curves_are_those_by_hand() -> None:
    flat, rising = [2.0] * 6, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    samples = figure(
        'fig5', rl_flock_spread=flat, pierson_flock_spread=rising, strombom_flock_spread=flat
    )
    sweep = Sweep(samples, POLICY)
    assert slope('pierson', 'flock_spread')(sweep)[0] == pytest.approx(1.0)
    assert ratio('pierson', 'RL', 'flock_spread')(sweep)[0] == pytest.approx(3.5 / 2)
    assert change('pierson', 'flock_spread', 2, 6)(sweep)[0] == pytest.approx(3.0)
    worst = below('', 'flock_spread', 'RL', 'pierson')
    assert finding_of(worst, sweep).value == pytest.approx(2.0)
    assert finding_of(worst, sweep).verdict == DISAGREES


def test_what_is_not_in_the_rows_is_undecided_with_a_reason() -> None:
    samples = figure('fig5', strombom_flock_spread=[1.0] * 6)
    for policy, reason in (('', 'no rows of a policy'), ('policy:x', 'no rows of policy:x')):
        clause = Clause('', ratio('RL', 'strombom', 'flock_spread'), 0, 1)
        finding = finding_of(clause, Sweep(samples, policy))
        assert (finding.verdict, finding.reason) == (UNDECIDED, reason)


TENS = np.arange(10.0, 101.0, 10)
AS_IN_THE_PAPER = {
    'pierson_completion_time': 0.67 * (100 + TENS),
    'rl_completion_time': 100 + TENS,
    'strombom_completion_time': 110 + TENS,
    'pierson_shepherd_path_length': np.full(10, 400.0),
    'rl_shepherd_path_length': np.full(10, 100.0),
    'strombom_shepherd_path_length': np.full(10, 220.0),
    'pierson_flock_spread': 3 + 0.02 * TENS,
    'rl_flock_spread': 1.43 + 0.0143 * TENS,
    'strombom_flock_spread': 1 + 0.01 * TENS,
    'pierson_flock_path_length': np.full(10, 90.0),
    'rl_flock_path_length': np.full(10, 60.0),
    'strombom_flock_path_length': np.full(10, 62.0),
}


def test_numbers_like_those_of_the_paper_agree_with_all_it_states_on_figure_4() -> None:
    outcomes = verdicts_on_samples(figure('fig4', **AS_IN_THE_PAPER), POLICY)
    assert len(outcomes) == sum(claim.experiment == 'fig4' for claim in CLAIMS)
    assert [j.verdict for j in outcomes] == [AGREES] * len(outcomes)


def test_numbers_the_other_way_round_disagree() -> None:
    other = {
        name.replace('rl_', 'x_').replace('pierson_', 'rl_').replace('x_', 'pierson_'): values
        for name, values in AS_IN_THE_PAPER.items()
    }
    outcomes = {
        j.statement: j.verdict for j in verdicts_on_samples(figure('fig4', **other), POLICY)
    }
    for start in ('Pierson is the fastest', 'Pierson shepherds', 'RL has the shortest'):
        assert next(v for s, v in outcomes.items() if s.startswith(start)) == DISAGREES


def test_a_policy_that_was_not_trained_on_reynolds_gets_no_verdict_there() -> None:
    high = np.full(10, 0.99)
    samples = figure('fig8', rl_fraction_reached=high, pierson_fraction_reached=high)
    judged = verdicts_on_samples(samples, POLICY)
    own = [j for j in judged if j.policy]
    assert own
    assert {j.verdict for j in own} == {UNDECIDED}
    assert 'not trained with the Reynolds' in own[0].findings[0].reason
    assert own[0].findings[0].value == pytest.approx(0.99)
    assert next(j for j in judged if j.statement.startswith('Pierson brings')).verdict == AGREES


def test_a_figure_is_certain_once_wider_intervals_decide_all_its_statements() -> None:
    samples = figure('fig4', **AS_IN_THE_PAPER)
    assert is_certain(samples, POLICY)
    assert not is_certain(samples, 'policy:none'), 'without rows nothing is decided'
    rng = np.random.default_rng(0)
    noisy = {
        key: np.clip(values.mean(axis=1, keepdims=True) * rng.normal(1, 0.5, (10, 20)), 1e-3, None)
        for key, values in samples.values.items()
    }
    few = replace(samples, values=noisy, seeds=tuple(range(20)))
    assert not is_certain(few, POLICY)
    table = replace(samples, experiment=replace(samples.experiment, name='table'))
    assert not is_certain(table, POLICY), 'nothing is stated of it'


def test_each_policy_is_judged_alone_and_only_the_primary_one_counts() -> None:
    high = np.full(10, 0.99)
    samples = figure('fig4', **AS_IN_THE_PAPER, rl_fraction_reached=high)
    worse = {
        ('policy:other', metric): values * (3.0 if metric == 'shepherd_path_length' else 1.0)
        for (name, metric), values in samples.values.items()
        if name == POLICY
    }
    both = replace(samples, values=samples.values | worse)
    for primary, other in ((POLICY, 'policy:other'), ('policy:other', POLICY)):
        judged = verdicts_on_samples(both, primary)
        assert {j.policy for j in judged if j.primary} <= {primary, ''}
        assert {j.policy for j in judged if not j.primary} == {other}
        alone = verdicts_on_samples(samples, POLICY)
        own = [j.verdict for j in judged if j.policy in (POLICY, '')]
        assert own == [j.verdict for j in alone], 'another policy changes nothing'
        assert sum(counts(judged).values()) == len(alone)
    assert counts(verdicts_on_samples(both, POLICY))[AGREES] == 7
    assert counts(verdicts_on_samples(both, 'policy:other'))[AGREES] < 7
    missing = verdicts_on_samples(samples, 'policy:none')
    assert {j.verdict for j in missing if j.policy == 'policy:none'} == {UNDECIDED}
    assert missing[0].findings[0].reason == 'no rows of policy:none'


def test_a_primary_policy_stands_for_the_flock_of_its_training() -> None:
    default = primary_policies('default')
    assert default == {'strombom': 'policy:paper_network', 'reynolds': 'policy:reynolds'}
    for flock, name in default.items():
        assert trained_on(name) == {flock}
        assert has_critic(name), 'PPO, as in the paper'
    assert set(primary_policies('third').values()) == {
        'policy:third_strombom', 'policy:third_reynolds'
    }  # fmt: skip
    chosen = primary_policies('third', ('policy:reynolds',))
    assert chosen == {'strombom': 'policy:third_strombom', 'reynolds': 'policy:reynolds'}
    chosen = primary_policies('third', ('policy:general',))
    assert chosen == {'strombom': 'policy:general', 'reynolds': 'policy:third_reynolds'}
    with pytest.raises(ConfigError, match='expected one policy for the strombom flock'):
        primary_policies('default', ('policy:strombom', 'policy:imitation'))


@pytest.mark.parametrize(
    ('name', 'flocks', 'critic'),
    [('imitation', {'strombom'}, False), ('strombom', {'strombom'}, True),
     ('paper_network', {'strombom'}, True),
     ('escort', {'crowd'}, False),
     ('third_strombom', {'strombom'}, True),
     ('reynolds', {'reynolds'}, True), ('general', {'strombom'}, False)],
)  # fmt: skip
def test_what_a_shipped_policy_was_trained_on(name: str, flocks: set[str], critic: bool) -> None:
    assert trained_on(f'policy:{name}') == flocks
    assert has_critic(f'policy:{name}') is critic


def test_what_a_policy_was_trained_on_is_not_guessed_from_names(tmp_path: Path) -> None:
    path = tmp_path / 'x.safetensors'
    record = {
        'command': 'shepherd train dagger --start runs/reynolds ppo --flock both',
        'config': {'run': {'task': {'flock': 'strombom'}}},
    }
    save_policy(path, Policy(PolicyConfig()), record)
    assert trained_on(f'policy:{path}') == {'strombom'}
    assert not has_critic(f'policy:{path}')


# ---- curves and critics ----


def curve(samples: float, returns: Any) -> Curve:
    return Curve('x', np.linspace(0, samples, len(returns)), np.array(returns, float), True)


@pytest.mark.parametrize(
    ('samples', 'returns', 'expected'),
    [
        (100e6, [*range(20), *[20] * 20], AGREES),
        (100e6, range(40), DISAGREES),
        (20e6, range(40), UNDECIDED),
        (20e6, [*range(20), *[20] * 20], AGREES),
        (1e6, [*range(20), *[20] * 20], UNDECIDED),
        (100e6, range(40, 0, -1), DISAGREES),
        (100e6, [1, 2, 3], UNDECIDED),
    ],
)
def test_a_curve_rises_and_flattens_or_does_not(
    samples: float, returns: Any, expected: str
) -> None:
    assert curve_verdict(curve(samples, returns))[0] == expected


def test_curves_are_found_in_files_and_runs(tmp_path: Path) -> None:
    lines = [{'samples': k, 'reward': k / 1000} for k in range(3)]
    (tmp_path / 'run').mkdir()
    for path in (tmp_path / 'a.jsonl', tmp_path / 'run' / 'curve.jsonl'):
        path.write_text('\n'.join(map(json.dumps, lines)))
    found = find_curves([tmp_path])
    assert [(c.name, c.returns.tolist()) for c in found] == [('a', [0, 1, 2]), ('run', [0, 1, 2])]
    (tmp_path / 'a.jsonl').write_text('\n'.join(
        json.dumps({'samples': k, 'reward': 9.0} | ({'eval/return': k} if k % 2 else {}))
        for k in range(4)
    ))  # fmt: skip
    (whole,) = find_curves([tmp_path / 'a.jsonl'])
    assert (whole.samples.tolist(), whole.returns.tolist()) == ([1, 3], [1, 3])
    (missing,) = verdicts_on_curves([], {'strombom': 'policy:x'})
    assert (missing.verdict, missing.primary) == (UNDECIDED, True)
    assert missing.findings[0].reason == 'no curve of x'
    (tmp_path / 'b.jsonl').write_text('{"loss": 1}')
    with pytest.raises(ConfigError, match=r'b.jsonl is no curve of a training'):
        find_curves([tmp_path / 'b.jsonl'])


def test_trainings_of_one_policy_are_judged_together() -> None:
    flat, steep = [*range(20), *[20] * 20], list(range(40))
    names = {'a': flat, 'b': flat, 'a.seed_1': steep}
    samples = np.linspace(0, 100e6, 40)
    curves = [Curve(name, samples, np.array(r, float), True) for name, r in names.items()]
    first, second = verdicts_on_curves(curves, {'strombom': 'policy:a'})
    assert (first.policy, first.verdict) == ('policy:a', DISAGREES)  # one of its two does
    assert [f.verdict for f in first.findings] == [AGREES, DISAGREES]
    assert (second.policy, second.verdict) == ('policy:b', AGREES)
    assert (first.primary, second.primary) == (True, False)
    both = verdicts_on_curves(curves, {'strombom': 'policy:a', 'reynolds': 'policy:b'})
    assert [j.policy for j in both] == ['policy:a and policy:b']
    assert [f.verdict for f in both[0].findings] == [AGREES, DISAGREES, AGREES]


def test_a_smoothed_curve_is_the_mean_within_its_window() -> None:
    samples = np.array([0.0, 1, 2, 3, 10])
    returns = np.array([4.0, 8, 0, 6, 1])
    found = smoothed(Curve('a', samples, returns, False), window=2.0)
    assert found.tolist() == [6, 4, 14 / 3, 3, 1]


def test_a_value_map_is_what_the_critic_says_of_the_third_shepherd() -> None:
    torch.manual_seed(0)
    policy = Policy(PolicyConfig()).eval()
    found = value_map(policy, seed=3)
    again = value_map(policy, seed=3)
    assert np.array_equal(found.values, again.values)
    assert len(np.unique(found.values)) > 80
    assert -1.0 <= found.behind <= 1.0
    assert 0.0 < found.high_share < 1.0
    assert math.isfinite(found.gradient)


def value_map_with(**values: Any) -> ValueMap:
    """Return a map with the flock at (0, 10) m, and values over it as a function of x and y."""
    x, y = np.meshgrid(places(), places())
    sheep = np.array([[-1.0, 10.0], [1.0, 10.0]])
    return ValueMap(values['of'](x, y), sheep, np.array([[0.0, 20.0]] * 2), 4.0)


def test_a_speck_is_not_the_best_place() -> None:
    behind = value_map_with(of=lambda x, y: np.exp(-(x**2 + (y - 18.75) ** 2) / 50))
    assert behind.best.tolist() == [0.0, 18.75]
    assert behind.behind == pytest.approx(1.0)
    speck = np.zeros((41, 41))
    speck[2, 20] = 5.0  # one place, in front, higher than all
    spoilt = replace(behind, values=behind.values + speck)
    assert spoilt.values.argmax() == 2 * 41 + 20
    assert spoilt.behind == pytest.approx(1.0)
    assert spoilt.high_share == pytest.approx(behind.high_share, abs=0.01)


def test_the_gradient_and_the_area_are_those_by_hand() -> None:
    # values grow with y: near the flock the mean y of a sector is as far behind as in front
    slope = value_map_with(of=lambda x, y: y)
    near = [
        (x, y) for x in places() for y in places()
        if math.hypot(x, y - 10) <= 10 and y - 10 >= 0.5 * max(math.hypot(x, y - 10), 1e-12)
        and (x, y) != (0, 10)
    ]  # fmt: skip
    ahead = [20 - y for _, y in near]  # mirrored at the flock
    low, high = np.percentile(slope.values, [2, 98])
    expected = (np.mean([y for _, y in near]) - np.mean(ahead)) / (high - low)
    assert slope.gradient == pytest.approx(expected, rel=0.02)
    assert value_map_with(of=lambda x, y: -y).gradient == pytest.approx(-slope.gradient)
    assert value_map_with(of=lambda x, y: x).gradient == pytest.approx(0.0, abs=1e-9)
    assert slope.high_share == np.mean(places() > low + 0.8 * (high - low))


def test_each_critic_is_judged_alone_and_over_flocks() -> None:
    behind = value_map_with(of=lambda x, y: np.exp(-(x**2 + (y - 17) ** 2) / 200))
    narrow = value_map_with(of=lambda x, y: np.exp(-(x**2 + (y - 17) ** 2) / 20))
    front = value_map_with(of=lambda x, y: np.exp(-(x**2 + (y + 17) ** 2) / 10))
    primary = {'strombom': 'policy:paper_network', 'reynolds': 'policy:reynolds'}
    maps = {
        'policy:paper_network': [behind] * 4,
        'policy:reynolds': [narrow] * 4,
        'policy:strombom': [front] * 4,
    }
    judged = {(j.statement, j.policy): j for j in verdicts_on_values(maps, primary)}
    both = 'policy:paper_network and policy:reynolds'
    assert {key: j.verdict for key, j in judged.items()} == {
        (BEHIND, both): AGREES,
        (AREAS, both): AGREES,
        (BEHIND, 'policy:strombom'): DISAGREES,
        (AREAS, 'policy:strombom'): DISAGREES,  # smaller than that of the other flock
    }
    assert [j.primary for j in judged.values()] == [True, True, False, False]
    spread = maps | {'policy:reynolds': [narrow, narrow, front, front]}
    again = {j.statement: j.verdict for j in verdicts_on_values(spread, primary) if j.primary}
    assert again[BEHIND] == UNDECIDED, 'an interval over flocks'
    assert {j.verdict for j in verdicts_on_values({}, primary)} == {UNDECIDED}


def test_the_summary_counts_each_statement_once_with_its_primary_policy() -> None:
    def judged(statement: str, policy: str, low: float, primary: bool = True) -> Verdict:
        clause = bare_clause('x', 0.0)
        found = strict_verdict(low, low + 0.2, 0.0, 1.0)
        finding = ClauseFinding(clause, low, low, low + 0.2, found, strict=found)
        return Verdict('fig4', statement, policy, (finding,), (None,), primary)

    inside, outside, across = 0.5, 2.0, 0.9
    lines = counts_by_figure([
        judged('one', 'policy:a', inside), judged('one', 'policy:b', outside, primary=False),
        judged('two', 'policy:a', inside), judged('two', 'policy:b', inside, primary=False),
        judged('three', 'policy:a', outside), judged('three', 'policy:b', inside, primary=False),
        judged('four', '', across),
    ])  # fmt: skip
    assert lines[-1] == '| **all** | **2** | **0** | **1** | **1** |'
    assert lines[-2] == '| [Figure 4: size of the flock](fig4.md) | 2 | 0 | 1 | 1 |'


# ---- files ----


def test_rows_that_are_not_ours_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    foreign, torn, empty = tmp_path / 'f.parquet', tmp_path / 't.parquet', tmp_path / 'empty'
    parquet.write_table(pa.table({'a': [1]}), foreign)
    torn.write_bytes(b'PAR1 no')
    empty.mkdir()
    old = tmp_path / 'o.parquet'
    table = made_up(Setting(), 'idle', completion_time=[1.0]).drop_columns(['seed'])
    parquet.write_table(table, old)
    for path, message in (
        (foreign, 'is no table of episodes'),
        (torn, 'is no whole Parquet file'),
        (old, 'has other columns'),
        (empty, 'has no Parquet files'),
        (tmp_path / 'none', 'is not there'),
    ):
        assert main(['figures', str(path), '--out', str(tmp_path / 'x')]) == 2
        assert message in capsys.readouterr().err


def test_rows_of_two_kinds_are_not_mixed(tmp_path: Path) -> None:
    short = made_up(Setting(sheep=20, steps=5), 'idle', completion_time=[1.0])
    whole = made_up(Setting(sheep=10), 'idle', completion_time=[1.0])
    other = replace(EXPERIMENTS['fig4'], controllers=('idle',))
    with pytest.raises(ConfigError, match='rows with steps 5 and 1000 are mixed'):
        samples_of(Results(pa.concat_tables([short, whole])), other)
    again = whole.set_column(0, schema().field('key'), pa.array(['another']))
    with pytest.raises(ConfigError, match='rows of 2 configurations or checkpoints'):
        samples_of(Results(pa.concat_tables([whole, again])), other)


@pytest.mark.system
def test_the_page_has_every_statement_and_the_same_bytes_again(tmp_path: Path) -> None:
    for name in ('fig6', 'starts'):
        experiment = EXPERIMENTS[name]
        for controller in (POLICY, 'strombom', 'pierson'):
            for k, setting in enumerate(experiment.settings):
                values = {m: [1.0 + k, 2.0 + k] for m in value_names()}
                path = tmp_path / 'rows' / f'{name}_{controller[:3]}_{k}.parquet'
                write_rows(path, made_up(setting, controller, **values))
    # the plain start without noise is in both, and counts once
    cells = {str(s) for name in ('fig6', 'starts') for s in EXPERIMENTS[name].settings}
    assert len(read_results([tmp_path / 'rows'])) == len(cells) * 3 * 2
    words = ['figures', str(tmp_path / 'rows'), '--report', '--command', 'make paper']
    for out in ('a', 'b'):
        assert main([*words, '--out', str(tmp_path / out)]) == 0
    names = sorted(path.name for path in (tmp_path / 'a').iterdir())
    assert {'README.md', 'summary.csv', 'fig6.png', 'fig6.svg', 'starts.png'} <= set(names)
    for name in names:
        same = (tmp_path / 'a' / name).read_bytes() == (tmp_path / 'b' / name).read_bytes()
        assert same, name
    text = (tmp_path / 'a' / 'README.md').read_text()
    assert 'A trial, not a result' in text
    assert 'shepherd train dagger' in text
    for claim in CLAIMS:
        page = (tmp_path / 'a' / f'{claim.experiment}.md').read_text()
        assert f'| {claim.statement} | **' in page
        assert page.index('## Statements') < page.index('## Verdict') < page.index('## Cause')
    found = json.loads((tmp_path / 'a' / 'verdicts.json').read_text())
    assert list(found) == ['default']
    assert sum(found['default'].values()) == 35
