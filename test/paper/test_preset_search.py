"""The search of choices: what is tried is what is said, and it goes on where it was cut off."""

from __future__ import annotations

from dataclasses import asdict, replace
from itertools import islice
import json
import math
from pathlib import Path

import pytest
from shepherd_ros.cli import main
from shepherd_ros.config import ConfigError
from shepherd_ros.experiments.catalog import EXPERIMENTS, OF_THE_PAPER
from shepherd_ros.experiments.methods import make_method
from shepherd_ros.experiments.setting import env_config, Setting
from shepherd_ros.paper.claims import AGREES, DISAGREES, UNDECIDED
from shepherd_ros.paper.preset_scores import named_preset, preset_scores
from shepherd_ros.paper.preset_search import (
    attempt,
    CANDIDATE_NAME,
    CHOICES,
    findings,
    gap_of,
    KnownTables,
    preset_of,
    proposals,
    score_of,
    search,
    short_experiment,
    Tried,
)
from shepherd_ros.sim.presets import PRESETS, world_preset

DEFAULT = {path: values[0] for path, values in CHOICES.items()}
OTHER = {path: values[-1] for path, values in CHOICES.items()}


def test_the_first_candidate_is_the_default_preset(monkeypatch: pytest.MonkeyPatch) -> None:
    assert next(proposals(0, [])) == DEFAULT
    monkeypatch.setitem(PRESETS._entries, CANDIDATE_NAME, preset_of(DEFAULT))
    for flock in ('strombom', 'reynolds'):
        assert world_preset(CANDIDATE_NAME, flock) == world_preset('default', flock)
        for name in ('strombom', 'pierson'):
            own = make_method(name, Setting(preset=CANDIDATE_NAME, flock=flock))
            assert own.config == make_method(name, Setting(flock=flock)).config


def test_every_choice_arrives_where_it_belongs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PRESETS._entries, CANDIDATE_NAME, preset_of(OTHER))
    for path, value in OTHER.items():
        kind, _, rest = path.partition('.')
        name, _, option = rest.partition('.')
        if kind == 'dt':
            assert env_config(Setting(preset=CANDIDATE_NAME)).world.dt == value
        elif kind == 'flock':
            flock = env_config(Setting(preset=CANDIDATE_NAME, flock=name)).world.flock
            assert getattr(flock, option) == value
        else:
            assert (
                getattr(make_method(name, Setting(preset=CANDIDATE_NAME)).config, option) == value
            )


def test_the_points_are_those_of_the_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PRESETS._entries, CANDIDATE_NAME, preset_of(DEFAULT))
    for name in OF_THE_PAPER:
        whole = EXPERIMENTS[name].settings
        short = short_experiment(name).settings
        assert {replace(s, preset='default') for s in short} < set(whole)
        assert {s.preset for s in short} == {CANDIDATE_NAME}


def test_an_undecided_number_counts_half() -> None:
    verdicts = {'a': AGREES, 'b': UNDECIDED, 'c': DISAGREES, 'd': AGREES}
    near = Tried({}, verdicts, {}, {'a': 0.0, 'b': 0.0, 'c': 0.0, 'd': 0.0})
    far = replace(near, gaps=near.gaps | {'a': 9.0, 'c': 1.0})
    assert near.score == far.score == 2.5
    assert near.merit == pytest.approx(2.9)
    assert far.merit == pytest.approx(2.7)
    assert replace(near, gaps={'c': math.inf}).merit == 2.5


def test_a_gap_is_the_way_to_the_nearer_bound() -> None:
    assert gap_of(3.0, 4.0, 8.0) == 0.25
    assert gap_of(10.0, 4.0, 8.0) == 0.25
    assert gap_of(5.0, 4.0, 8.0) == 0
    assert gap_of(math.nan, 4.0, 8.0) == gap_of(math.inf, -math.inf, 1.0) == math.inf


@pytest.mark.system
def test_a_search_that_is_cut_off_goes_on_with_the_same_candidates(tmp_path: Path) -> None:
    whole = list(search(tmp_path / 'whole', 3, 3, 2, steps=2))
    list(islice(search(tmp_path / 'cut', 3, 3, 2, steps=2), 1))
    assert len((tmp_path / 'cut').read_text().splitlines()) == 1
    assert list(search(tmp_path / 'cut', 3, 3, 2, steps=2)) == whole
    assert (tmp_path / 'cut').read_text() == (tmp_path / 'whole').read_text()
    assert len({json.dumps(tried.candidate) for tried in whole}) == 3
    assert CANDIDATE_NAME not in PRESETS


def test_the_file_of_another_search_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'tried'
    lines = [asdict(Tried(c, {}, {}, {})) for c in (DEFAULT, OTHER, DEFAULT)]
    path.write_text(''.join(json.dumps(line) + '\n' for line in lines))
    assert main(['search', '--out', str(path)]) == 2
    assert 'is of another --seed or version; give another --out' in capsys.readouterr().err


@pytest.mark.parametrize('line', ['{"candidate": {}, "verdicts": {}}', '{"candidate": {"dt"', '7'])
def test_a_line_that_is_torn_or_foreign_is_named(
    line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'tried'
    path.write_text(json.dumps(asdict(Tried(DEFAULT, {}, {}, {}))) + '\n' + line + '\n')
    assert main(['search', '--out', str(path)]) == 2
    assert f'line 2 of {path} is no candidate' in capsys.readouterr().err


def test_only_numbers_about_the_baselines_are_judged() -> None:
    tried = attempt(DEFAULT, 2, steps=2)
    assert len(tried.verdicts) == 19
    assert not any(' RL' in text.rpartition(': ')[2] for text in tried.verdicts)


def test_only_cells_that_a_choice_changes_are_run_again() -> None:
    cells: KnownTables = {}
    attempt(DEFAULT, 2, steps=2, known=cells)
    before = len(cells)
    changed = DEFAULT | {'controllers.pierson.lead': 4.0}
    tried = attempt(changed, 2, steps=2, known=cells)
    assert before % 2 == 0
    assert len(cells) == before + before // 2  # those of one of two controllers
    assert tried == attempt(changed, 2, steps=2)


@pytest.mark.system
def test_presets_stand_side_by_side_with_their_scores() -> None:
    lines = preset_scores(['default', 'fine_dt'], 2, steps=2).splitlines()
    rows = [[cell.strip() for cell in line.strip('|').split('|')] for line in lines]
    assert rows[0][3:] == [
        '`default`, seeds from 0', '`default`, seeds from 1000',
        '`fine_dt`, seeds from 0', '`fine_dt`, seeds from 1000',
    ]  # fmt: skip
    tried = attempt(DEFAULT, 2, steps=2)
    verdicts = {f'{row[0]}: {row[1]}': row[3].rpartition(', ')[2] for row in rows[2:-1]}
    assert verdicts == tried.verdicts
    assert rows[-1][3] == f'**{tried.score:g} of 19**'


@pytest.mark.system
def test_the_best_is_reported_on_other_seeds_than_those_it_was_found_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'tried.jsonl'
    words = ['search', '--candidates', '2', '--episodes', '2', '--steps', '2', '--out', str(path)]
    assert main(words) == 0
    assert str(tmp_path / 'tried.md') in capsys.readouterr().out
    found = max(map(json.loads, path.read_text().splitlines()), key=lambda t: score_of(
        t['verdicts'].values()))  # fmt: skip
    head, _, *rows, score = (tmp_path / 'tried.md').read_text().splitlines()
    assert head.endswith('default, seeds from 1000 | best, seeds from 0 | best, seeds from 1000 |')
    cells = [[cell.strip() for cell in row.strip('|').split('|')] for row in rows]
    assert [row[5].rpartition(', ')[2] for row in cells] == [*found['verdicts'].values()]
    other = findings(preset_of(found['candidate']), 2, 2, first=1000)
    assert [row[6].rpartition(', ')[2] for row in cells] == [f.strict for f in other.values()]
    assert f'**{score_of(f.strict for f in other.values()):g} of 19**' in score


def test_a_preset_can_be_named_with_other_choices() -> None:
    summed = named_preset('third+flock.strombom.normalize_shepherds=false+dt=0.1')
    third = PRESETS['third']
    assert (summed.dt, third.dt) == (0.1, 0.2)
    assert not summed.flock['strombom']['normalize_shepherds']
    assert third.flock['strombom']['normalize_shepherds'], 'the preset itself is as it was'
    assert summed.controllers == third.controllers
    for word, message in (
        ('thrd', "preset is 'thrd'"),
        ('third+dtt=0.1', "choice is 'dtt'"),
        ('third+dt=7', r"dt is '7': expected one of 0\.5, 0\.1"),
    ):
        with pytest.raises(ConfigError, match=message):
            named_preset(word)


def test_a_mistake_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['search', '--candidates', '0', '--out', str(tmp_path / 'x')]) == 2
    assert '--candidates is 0' in capsys.readouterr().err
    assert main(['search', '--presets', 'default', 'papr']) == 2
    assert "preset is 'papr'" in capsys.readouterr().err
