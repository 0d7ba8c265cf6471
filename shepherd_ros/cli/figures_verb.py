"""Verb figures: the paper's figures from rows of results, and a page of verdicts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TYPE_CHECKING

from shepherd_ros.cli.out_folders import claimed_folder
from shepherd_ros.cli.progress import progress
from shepherd_ros.cli.user_error import UserError
import tyro

if TYPE_CHECKING:
    from collections.abc import Mapping

    from shepherd_ros.experiments.results import Results
    from shepherd_ros.experiments.samples import Samples
    from shepherd_ros.paper.judging import Judged


@dataclass
class Figures:
    """
    Draw the figures of the paper and of the sweeps beyond it, as PNG and SVG.

    Figures of the paper are of the first preset. In a sweep beyond the paper, only controllers
    that have all its settings are drawn.
    """

    rows: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Rows that shepherd evaluate wrote: Parquet files or folders of them."""
    out: Path = Path('out/figures')
    """Folder of the pictures."""
    curves: tuple[Path, ...] = ()
    """Training curves for figure 3: .jsonl files, runs, or folders of them."""
    checkpoints: tuple[str, ...] = ()
    """Checkpoints for figure 9; those of the policies in the rows if not given."""
    presets: tuple[str, ...] = ()
    """Presets to judge, the first one to draw; all in the rows, `third` first, if not given."""
    primary: tuple[str, ...] = ()
    """Policies that stand for the paper's RL, each for its flock; others are variants."""
    set: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """PATH=VALUE that the rows were made with (repeatable)."""
    report: bool = False
    """
    Also write a verdict on each statement: README.md, a page a figure, verdicts.json;
    protection.md of rows of payload protection.
    """
    command: str = 'shepherd figures'
    """What the page says it was made by."""
    overwrite: bool = False
    """Write into a folder that holds something else."""

    def run(self) -> int:
        """Draw all; return the exit code."""
        from shepherd_ros.experiments.results import read_results
        from shepherd_ros.paper.curves import find_curves
        from shepherd_ros.paper.drawing import save
        from shepherd_ros.paper.judging import judge
        from shepherd_ros.paper.primary import primary_policies
        import torch

        claimed_folder('--out', self.out, '*.svg', self.overwrite)
        torch.set_num_threads(1)
        if not self.rows:
            raise UserError('figures needs rows: expected files or folders of shepherd evaluate')
        rows, curves = read_results(self.rows), find_curves(self.curves)
        samples = self._samples(rows)
        beyond = self._beyond(rows)
        if not samples and not beyond:
            raise UserError('the rows are of no experiment: expected those of shepherd evaluate')
        primary = {name: primary_policies(name, self.primary) for name in samples}
        with progress('value maps', 1) as show:
            show(0)
            maps = self._maps(rows)
        judged = [judge(name, primary[name], s, curves, maps) for name, s in samples.items()]
        drawn = dict(next(iter(samples.values()), {})) | beyond
        drawn.pop('cells', None)  # a table says more
        pictures = self._pictures(drawn, judged)
        if curves:
            from shepherd_ros.paper.figures import draw_curves

            pictures['fig3'] = draw_curves(curves)
        if maps:
            from shepherd_ros.paper.value_picture import draw_values

            pictures['fig9'] = draw_values({name: own[0] for name, own in maps.items()})
        for name, figure in pictures.items():
            print(*save(figure, self.out, name))
        if self.report and judged:
            self._report(judged, beyond, list(pictures), rows)
        if self.report:
            self._report_protection(beyond, list(pictures), rows)
        return 0

    def _samples(self, rows: Results) -> dict[str, dict[str, Samples]]:
        """Return the samples of the paper's experiments in the rows, by preset."""
        from shepherd_ros.experiments.catalog import EXPERIMENTS, OF_THE_PAPER
        from shepherd_ros.experiments.samples import samples_of

        found: dict[str, dict[str, Samples]] = {}
        for preset in self.presets or varied_presets(rows):
            for name in OF_THE_PAPER:
                chosen = EXPERIMENTS[name].with_preset(preset).with_changes(self.set)
                samples = samples_of(rows, chosen, least=2)
                if samples is not None:
                    found.setdefault(preset, {})[name] = samples
                    print(*samples.notes, sep='\n', end='\n' if samples.notes else '')
        return found

    def _beyond(self, rows: Results) -> dict[str, Samples]:
        """Return the samples of the sweeps beyond the paper, in the first preset that has them."""
        from shepherd_ros.experiments.catalog import EXPERIMENTS, OF_THE_PAPER
        from shepherd_ros.experiments.samples import samples_of

        found: dict[str, Samples] = {}
        for name, experiment in EXPERIMENTS.items():
            for preset in () if name in OF_THE_PAPER else (*self.presets, 'default'):
                chosen = experiment.with_preset(preset).with_changes(self.set)
                samples = samples_of(rows, chosen, least=2, whole=True)
                if samples is not None:
                    found.setdefault(name, samples)
        return found

    def _maps(self, rows: Results) -> Mapping[str, Any]:
        """Return the value maps of the policies with a critic, those of --checkpoints if given."""
        from shepherd_ros.experiments.methods import full_name
        from shepherd_ros.experiments.value_map import has_critic
        from shepherd_ros.paper.value_verdicts import value_maps

        known = [name for name in rows.distinct('controller') if name.startswith('policy:')]
        named = [full_name(f'policy:{checkpoint}') for checkpoint in self.checkpoints]
        names = dict.fromkeys(named or known)
        return {name: value_maps(name) for name in names if has_critic(name)}

    def _pictures(self, samples: Mapping[str, Samples], judged: list[Judged]) -> dict[str, Any]:
        """Return the pictures of the samples, by experiment, and those of all."""
        from shepherd_ros.paper.figures import draw
        from shepherd_ros.paper.summary import draw_summary
        from shepherd_ros.paper.verdict_picture import draw_verdicts

        pictures = {}
        with progress('drawing', len(samples)) as show:
            for done, (name, found) in enumerate(samples.items()):
                show(done, text=name)
                pictures[name] = draw(found)
        if (summary := draw_summary(samples.values())) is not None:
            pictures['summary'] = summary
        if judged:
            pictures['verdicts'] = draw_verdicts(judged)
        return pictures

    def _report(
        self,
        judged: list[Judged],
        beyond: Mapping[str, Samples],
        pictures: list[str],
        rows: Results,
    ) -> None:
        """Write the pages, verdicts.json, summary.csv and table.md."""
        from shepherd_ros.experiments.criteria import criteria_page
        from shepherd_ros.experiments.table import CSV_HEADER, csv_rows, grids
        from shepherd_ros.paper.figure_pages import beyond_page, figure_page, read_causes
        from shepherd_ros.paper.judging import counts_as_json
        from shepherd_ros.paper.report import front_page
        from shepherd_ros.paper.verdict_tables import TITLES

        beyond = {n: s for n, s in beyond.items() if s.settings[0].task == 'herding'}
        causes = read_causes(self.out / 'causes.toml')
        pages = {f'{n}.md': figure_page(n, judged, pictures, causes) for n in TITLES}
        pages['README.md'] = front_page(judged, beyond, pictures, rows, self.command)
        pages['verdicts.json'] = counts_as_json(judged)
        of_all = [s for each in judged for s in each.samples.values()] + list(beyond.values())
        pages['summary.csv'] = CSV_HEADER + ''.join(map(csv_rows, of_all))
        if 'cells' in beyond and beyond['cells'].policies:
            cause = causes.get('beyond', {}).get('cells', '')
            pages['cells.md'] = criteria_page(beyond['cells'], cause)
        if beyond:
            pages['beyond.md'] = beyond_page(beyond, pictures, causes)
        if 'table' in beyond:
            pages['table.md'] = grids(beyond['table'])
        for name, text in pages.items():
            (self.out / name).write_text(text, encoding='utf-8')
        print(self.out / 'README.md')

    def _report_protection(
        self, beyond: Mapping[str, Samples], pictures: list[str], rows: Results
    ) -> None:
        """Write the page of payload protection, if there are rows of it."""
        from shepherd_ros.paper.figure_pages import read_causes
        from shepherd_ros.paper.protection_page import protection_page

        task = 'protection'
        samples = {name: s for name, s in beyond.items() if s.settings[0].task == task}
        if samples:
            causes = read_causes(self.out / 'causes.toml').get('beyond', {})
            own, path = rows.chosen(task=task), self.out / 'protection.md'
            text = protection_page(samples, pictures, causes, own, self.command)
            path.write_text(text, encoding='utf-8')
            print(path)


def varied_presets(rows: Results) -> list[str]:
    """Return the presets with rows of more than one setting of a flock, `third` first."""
    presets = []
    for preset in sorted(rows.distinct('preset'), key=lambda name: (name != 'third', name)):
        for flock in rows.distinct('flock'):
            mask = rows.where(preset=preset, flock=flock)
            fields = ('sheep', 'shepherds', 'noise', 'repulsion')
            if any(len(set(rows.columns[name][mask].tolist())) > 1 for name in fields):
                presets.append(preset)
                break
    return presets
