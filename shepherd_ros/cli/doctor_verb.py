"""Verb doctor: whether what is needed is there and works, and what to do."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
import json
import platform

from rich.console import Console
from rich.table import Table
from rich.text import Text
from shepherd_ros import __version__
from shepherd_ros.cli.progress import progress
from shepherd_ros.doctor.diagnosis import Diagnosis, DIAGNOSIS_LEVELS

_STYLES = {'ok': 'green', 'warning': 'yellow', 'error': 'bold red'}
_EXIT_ERROR = 1


@dataclass(kw_only=True)
class Doctor:
    """
    Check the installation and say what to do; exit code 1 if something fails.

    Two processes look for each other in the domain of ROS_DOMAIN_ID, as nodes do.
    """

    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        """Check all and print the findings; return the exit code."""
        from shepherd_ros.doctor.checks import run_checks

        rows: list[tuple[str, Diagnosis]] = []
        with progress('checking') as show:
            show(0)
            for row in run_checks():
                rows.append(row)
                show(len(rows), text=row[1].name)
        if self.json:
            found = [{'group': group, **asdict(finding)} for group, finding in rows]
            print(json.dumps({'version': __version__, 'checks': found}, indent=1))
        else:
            _print_page(rows)
        return _EXIT_ERROR if any(finding.level == 'error' for _, finding in rows) else 0


def _print_page(rows: list[tuple[str, Diagnosis]]) -> None:
    """Print the findings by group, then how many there are of each level."""
    console = Console(highlight=False)
    console.print(f'shepherd_ros {__version__} on {platform.system()} {platform.release()}')
    for title in dict.fromkeys(group for group, _ in rows):
        grid = Table.grid(padding=(0, 2))
        grid.add_column(width=max(map(len, DIAGNOSIS_LEVELS)))
        grid.add_column(width=max(len(finding.name) for _, finding in rows))
        grid.add_column(overflow='fold')
        for group, finding in rows:
            if group == title:
                text = Text(finding.text)
                if finding.fix:
                    text.append(f'\n→ {finding.fix}', style='bold')
                level = Text(finding.level, style=_STYLES[finding.level])
                grid.add_row(level, finding.name, text)
        console.print(f'\n[bold]{title}[/bold]')
        console.print(grid)
    counts = Counter(finding.level for _, finding in rows)
    worse = [
        f'{counts[name]} {name}{"" if counts[name] == 1 else "s"}' for name in DIAGNOSIS_LEVELS[1:]
    ]
    console.print('\n' + ', '.join([f'{counts["ok"]} ok', *worse]))
