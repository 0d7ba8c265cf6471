"""The drawing of nodes and topics, checked against the contract."""

from __future__ import annotations

from shepherd_ros.wire.topics import contract

WIDTH, HEIGHT, BOX = 760, 330, (132, 46)
NODES = {  # name -> center of its box, executables
    'flock_sim': (90, 165),
    'lidar': (370, 60),
    'policy': (650, 60),
    'heuristics': (650, 165),
    'metrics': (650, 270),
}
HEURISTICS = ('strombom', 'pierson', 'drover')
STATE = ('episode', 'goal', 'flock/poses', 'shepherds/poses')
EDGES = (  # from, to, topics, points of the line, place of the label
    ('flock_sim', 'lidar', STATE, [(90, 142), (90, 60), (304, 60)], None),
    ('flock_sim', 'heuristics', STATE, [(156, 165), (584, 165)], (370, 157)),
    ('flock_sim', 'metrics', STATE, [(156, 175), (250, 175), (250, 270), (584, 270)], None),
    ('lidar', 'policy', ('shepherd_{h}/scan/sheep',), [(436, 60), (584, 60)], (510, 50)),
    ('policy', 'flock_sim', ('shepherd_{h}/cmd_vel',),
     [(716, 60), (742, 60), (742, 315), (70, 315), (70, 188)], None),
    ('heuristics', 'flock_sim', ('shepherd_{h}/cmd_vel',),
     [(716, 165), (742, 165), (742, 315), (70, 315), (70, 188)], (400, 307)),
)  # fmt: skip
STYLE = (
    '.g text{font:13px sans-serif;fill:var(--color-foreground-primary,#222)}'
    '.g rect{fill:var(--color-background-secondary,#f6f6f6);'
    'stroke:var(--color-foreground-muted,#666)}'
    '.g path{fill:none;stroke:var(--color-brand-primary,#0a58ca);stroke-width:1.5}'
    '.g marker path{fill:var(--color-brand-primary,#0a58ca);stroke:none}'
)


def _known(source: str, target: str, topic: str) -> bool:
    """Return whether the contract has the topic between these nodes."""
    row = contract()[0][topic]
    one = HEURISTICS if source == 'heuristics' else (source,)
    other = HEURISTICS if target == 'heuristics' else (target,)
    return set(one) <= {*row.publisher, *_roles(row.publisher)} and set(other) <= {
        *row.subscribers,
        *_roles(row.subscribers),
    }


def _roles(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the executables of a role."""
    return (*HEURISTICS, 'policy') if 'controller' in names else ()


def graph() -> str:
    """Return the drawing as SVG; ValueError if the contract says something else."""
    parts = []
    for source, target, topics, points, label in EDGES:
        for topic in topics:
            if not _known(source, target, topic):
                raise ValueError(f'{topic} does not go from {source} to {target}: mend graph.py')
        line = 'M' + ' L'.join(f'{x} {y}' for x, y in points)
        parts.append(f'<path d="{line}" marker-end="url(#tip)"/>')
        if label:
            text = ', '.join(topics).replace('{h}', '&lt;h&gt;')
            parts.append(
                f'<text x="{label[0]}" y="{label[1]}" text-anchor="middle">'
                f'{text.replace("/sheep", "/*")}</text>'
            )
    for name, (x, y) in NODES.items():
        left, top = x - BOX[0] // 2, y - BOX[1] // 2
        parts.append(f'<rect x="{left}" y="{top}" width="{BOX[0]}" height="{BOX[1]}" rx="6"/>')
        lines = [name] if name != 'heuristics' else ['strombom, pierson,', 'drover']
        first = y + 5 - 8 * (len(lines) - 1)
        for k, line in enumerate(lines):
            parts.append(f'<text x="{x}" y="{first + 16 * k}" text-anchor="middle">{line}</text>')
    tip = (
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0 L8 4 L0 8 z"/></marker></defs>'
    )
    body = '\n'.join(parts)
    return (
        f'<figure class="graph"><svg class="g" xmlns="http://www.w3.org/2000/svg" role="img" '
        f'aria-label="Nodes and topics" viewBox="0 0 {WIDTH} {HEIGHT}">\n'
        f'<style>{STYLE}</style>\n{tip}\n{body}\n</svg></figure>\n'
    )
