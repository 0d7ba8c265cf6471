"""The committed pages of results are those of the committed rows."""

from __future__ import annotations

from collections import Counter
import json
from pathlib import Path
import re

import pytest
from shepherd_ros.experiments.catalog import EXPERIMENTS, GROUPS, OF_THE_PAPER
from shepherd_ros.experiments.results import read_results
from shepherd_ros.experiments.samples import samples_of
from shepherd_ros.paper.claims import DISAGREES, VERDICTS
from shepherd_ros.paper.curves import find_curves
from shepherd_ros.paper.primary import primary_policies
from shepherd_ros.paper.protection_page import protection_page, protection_verdicts
from shepherd_ros.paper.protection_statements import PROTECTION_CLAIMS
from shepherd_ros.paper.statements import CLAIMS
from shepherd_ros.paper.verdict_tables import TITLES
from shepherd_ros.paper.verdicts import verdicts_on_curves, verdicts_on_samples
import tomllib

DOCS = Path(__file__).resolve().parents[2] / 'docs'
RESULTS = DOCS / 'results'
COUNTS = json.loads((RESULTS / 'verdicts.json').read_text(encoding='utf-8'))


def on_page(name: str, preset: str) -> dict[str, str]:
    """Return the verdicts of the primary policies on the page of a figure, by statement."""
    lines = (RESULTS / f'{name}.md').read_text(encoding='utf-8').splitlines()
    head = next(line for line in lines if line.startswith('| | primary'))
    column = [cell.strip() for cell in head.split('|')].index(f'primary, `{preset}`')
    rows = lines[lines.index(head) + 2 :]
    cells = [[cell.strip() for cell in row.split('|')] for row in rows[: rows.index('')]]
    return {row[1]: row[column].strip('*') for row in cells}


def test_the_counts_are_of_the_three_presets_and_of_all_statements() -> None:
    assert next(iter(COUNTS)) == 'third'
    assert set(COUNTS) >= {'default', 'third', 'table_literal'}
    for counted in COUNTS.values():
        assert list(counted) == list(VERDICTS)
        assert sum(counted.values()) == len(CLAIMS) + 3 == 35


@pytest.mark.system
@pytest.mark.parametrize('preset', list(COUNTS))
def test_pages_and_counts_are_those_of_the_rows(preset: str) -> None:
    rows = read_results(sorted(RESULTS.glob('*.parquet')))
    primary = primary_policies(preset)
    judged: dict[str, dict[str, str]] = {}
    for name in OF_THE_PAPER:
        samples = samples_of(rows, EXPERIMENTS[name].with_preset(preset), least=2)
        assert samples is not None
        found = verdicts_on_samples(samples, primary[samples.settings[0].flock])
        judged[name] = {o.statement: o.verdict for o in found if o.primary}
    (curve,) = (o for o in verdicts_on_curves(find_curves([DOCS / 'curves']), primary)
                if o.primary)  # fmt: skip
    judged['fig3'] = {curve.statement: curve.verdict}
    pages = {name: on_page(name, preset) for name in TITLES}
    for name, verdicts in judged.items():
        assert pages[name] == verdicts, name
    total = Counter(verdict for page in pages.values() for verdict in page.values())
    assert {kind: total[kind] for kind in VERDICTS} == COUNTS[preset]


def test_what_disagrees_has_a_cause() -> None:
    causes = tomllib.loads((RESULTS / 'causes.toml').read_text(encoding='utf-8'))
    for preset in ('third', 'default'):
        for name in TITLES:
            for statement, verdict in on_page(name, preset).items():
                assert verdict != DISAGREES or causes[preset].get(statement), statement


def test_every_cause_is_of_a_statement() -> None:
    causes = tomllib.loads((RESULTS / 'causes.toml').read_text(encoding='utf-8'))
    known = {statement for name in TITLES for statement in on_page(name, 'third')}
    for preset in set(causes) - {'beyond'}:
        assert set(causes[preset]) <= known
    assert set(causes['beyond']) <= set(EXPERIMENTS)


def test_links_of_the_pages_resolve() -> None:
    for page in RESULTS.glob('*.md'):
        for target in re.findall(r'\]\(([^)\s]+)\)', page.read_text(encoding='utf-8')):
            assert target.startswith('http') or (RESULTS / target).exists(), f'{target} of {page}'


@pytest.mark.system
def test_the_page_of_protection_follows_from_its_rows() -> None:
    rows = read_results([RESULTS / 'protection.parquet'])
    names = GROUPS['protection']
    found = {n: samples_of(rows, EXPERIMENTS[n], least=2, whole=True) for n in names}
    samples = {name: each for name, each in found.items() if each is not None}
    assert tuple(samples) == names
    causes = tomllib.loads((RESULTS / 'causes.toml').read_text(encoding='utf-8'))['beyond']
    page = (RESULTS / 'protection.md').read_text(encoding='utf-8')
    command = re.findall('^Made by `(.*?)`', page, re.MULTILINE)[0]
    assert protection_page(samples, names, causes, rows, command) == page
    assert len(protection_verdicts(samples)) == len(PROTECTION_CLAIMS) == 8
