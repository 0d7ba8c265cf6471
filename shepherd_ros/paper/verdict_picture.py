"""Picture of all verdicts: a row for each statement, a column for each preset."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import shorten

from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from shepherd_ros.paper.claims import AGREES, BETTER, DISAGREES, UNDECIDED, VERDICTS
from shepherd_ros.paper.drawing import new_figure
from shepherd_ros.paper.judging import Judged
from shepherd_ros.paper.verdict_tables import TITLES
from shepherd_ros.view.scene import INK

# fill (of Okabe and Ito) and letter of each verdict
LOOK = {
    AGREES: ('#009E73', 'A'),
    BETTER: ('#56B4E9', 'B'),
    DISAGREES: ('#D55E00', 'D'),
    UNDECIDED: ('#E8EAEC', 'U'),
}
WIDTH, STATEMENT_WIDTH = 96, 6.0  # of a statement: characters, inches


def draw_verdicts(judged: Sequence[Judged]) -> Figure:
    """Return the figure of the verdicts with the primary policies."""
    columns = [
        {(o.experiment, o.statement): o.verdict for o in each.outcomes if o.primary}
        for each in judged
    ]
    rows = [(name, s) for name in TITLES for figure, s in columns[0] if figure == name]
    figure, panels = new_figure(1, 1, STATEMENT_WIDTH + 1.1 * len(judged), 0.21 * (len(rows) + 3))
    axes = panels[0, 0]
    for y, (name, statement) in enumerate(rows):
        number = name.removeprefix('fig').replace('fractions', 'text')
        text = f'{shorten(statement, WIDTH, placeholder="...")}  [{number}]'
        axes.text(-0.15, y, text, ha='right', va='center', fontsize=7.5, color=INK)
        for x, found in enumerate(columns):
            fill, letter = LOOK[found[name, statement]]
            axes.add_patch(Rectangle((x, y - 0.45), 0.92, 0.9, facecolor=fill, linewidth=0))
            axes.text(x + 0.46, y, letter, ha='center', va='center', fontsize=7.5, color=INK)
    for x, each in enumerate(judged):
        axes.text(x + 0.46, -0.8, each.preset, ha='center', va='bottom', fontsize=8, color=INK)
        totals = ' '.join(f'{each.counts[k]}{LOOK[k][1]}' for k in VERDICTS)
        axes.text(x + 0.46, len(rows) - 0.2, totals, ha='center', va='top', fontsize=7, color=INK)
    axes.set(xlim=(-STATEMENT_WIDTH / 1.1, len(judged)), ylim=(len(rows) + 0.6, -1.8))
    axes.axis('off')
    words = ', '.join(f'{LOOK[kind][1]} {kind}' for kind in VERDICTS)
    figure.suptitle(f'Statements of the paper, by preset: {words}', fontsize=10, color=INK)
    return figure
