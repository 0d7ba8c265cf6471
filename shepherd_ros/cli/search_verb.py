"""Verb search: which choices that the paper leaves open agree with most of its statements."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
import sys

from shepherd_ros.cli.out_folders import made_folder
from shepherd_ros.cli.progress import progress, Show
from shepherd_ros.cli.user_error import UserError


@dataclass
class Search:
    """
    Search what the paper leaves open for what agrees best with its statements on the baselines.

    A candidate takes minutes. A search that is cut off goes on with the same command.
    """

    out: Path = Path('out/search.jsonl')
    """File of what was tried, a line each."""
    candidates: int = 100
    """How many to try, the default preset first."""
    episodes: int = 12
    """Episodes of each cell."""
    seed: int = 0
    """Seed of the candidates."""
    presets: tuple[str, ...] = ()
    """Instead of a search, print a table of how well these presets agree."""

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
            print(preset_scores(self.presets, self.episodes, on_preset=tell))
            return 0
        made_folder('--out', self.out.parent)
        with progress('candidates', self.candidates) as show:
            self._search(show)
        return 0

    def _search(self, show: Show) -> None:
        """Print every candidate that is better than all before."""
        from shepherd_ros.paper.claims import AGREES
        from shepherd_ros.paper.preset_search import CHOICES, search

        best = -1.0
        for number, tried in enumerate(
            search(self.out, self.seed, self.candidates, self.episodes), start=1
        ):
            show(number, text=f'{number} of {self.candidates}')
            if tried.score <= best:
                continue
            best = tried.score
            agree = sum(verdict == AGREES for verdict in tried.verdicts.values())
            changed = {p: v for p, v in tried.candidate.items() if v != CHOICES[p][0]}
            print(
                f'{number:4d}  score {best:g} of {len(tried.verdicts)}, {agree} agree: '
                f'{changed or "the default"}',
                flush=True,
            )
