"""Verb search: which choices that the paper leaves open agree with most of its statements."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
import sys
from typing import Any

from shepherd_ros.cli.out_folders import made_folder
from shepherd_ros.cli.progress import progress, Show
from shepherd_ros.cli.user_error import UserError


@dataclass
class Search:
    """
    Search what the paper leaves open for what agrees best with its statements on the baselines.

    The best candidate is reported on other seeds, in a table beside the file. A candidate takes
    minutes. A search that is cut off goes on with the same command.
    """

    out: Path = Path('out/search.jsonl')
    """File of what was tried, a line each."""
    candidates: int = 100
    """How many to try, the default preset first."""
    episodes: int = 12
    """Episodes of each cell."""
    seed: int = 0
    """Seed of the candidates."""
    steps: int = 1000
    """Steps of an episode."""
    presets: tuple[str, ...] = ()
    """Instead of a search, print a table of presets, or NAME+PATH=VALUE with other choices."""

    def run(self) -> int:
        """Search; print every candidate that is better than all before."""
        import torch

        if self.candidates < 1 or self.episodes < 2:
            raise UserError(
                f'--candidates is {self.candidates}, --episodes {self.episodes}: expected at '
                'least 1 and 2'
            )
        torch.set_num_threads(1)
        if self.presets:
            from shepherd_ros.paper.preset_scores import preset_scores

            tell = partial(print, file=sys.stderr)
            print(preset_scores(self.presets, self.episodes, self.steps, on_preset=tell))
            return 0
        made_folder('--out', self.out.parent)
        with progress('candidates', self.candidates) as show:
            best = self._search(show)
        from shepherd_ros.paper.preset_scores import both_seeds, score_table
        from shepherd_ros.paper.preset_search import preset_of
        from shepherd_ros.sim.presets import PRESETS

        columns: dict[str, Any] = {}
        for title, preset in (('default', PRESETS['default']), ('best', preset_of(best))):
            columns |= both_seeds(title, preset, self.episodes, self.steps, {})
        table = self.out.with_suffix('.md')
        table.write_text(score_table(columns) + '\n', encoding='utf-8')
        print(table)
        return 0

    def _search(self, show: Show) -> dict[str, Any]:
        """Print every candidate that is better than all before; return the best."""
        from shepherd_ros.paper.claims import AGREES
        from shepherd_ros.paper.preset_search import CHOICES, search

        best, choices = -1.0, {}
        for number, tried in enumerate(
            search(self.out, self.seed, self.candidates, self.episodes, self.steps), start=1
        ):
            show(number, text=f'{number} of {self.candidates}')
            if tried.score <= best:
                continue
            best, choices = tried.score, tried.candidate
            agree = sum(verdict == AGREES for verdict in tried.verdicts.values())
            changed = {p: v for p, v in tried.candidate.items() if v != CHOICES[p][0]}
            print(
                f'{number:4d}  score {best:g} of {len(tried.verdicts)}, {agree} agree: '
                f'{changed or "the default"}',
                flush=True,
            )
        return choices
