"""Mutants of a file by the operators of cosmic-ray, and a seeded sample of them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import random

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

Place = tuple[int, int]  # line from 1, column from 0


@dataclass(frozen=True)
class Mutant:
    """One small change of one file."""

    path: str  # from the root of the project
    operator: str
    occurrence: int
    line: int

    def source(self, original: str) -> str | None:
        """Return the text of the file with the change, None where that is no valid Python."""
        text = mutate_code(original, get_operator(self.operator)(), self.occurrence)
        try:
            same = text is None or ast.dump(ast.parse(text)) == ast.dump(ast.parse(original))
        except SyntaxError:
            return None
        return None if same else text

    def shown(self, original: str) -> str:
        """Return the changed lines before and after."""
        pairs = zip(original.splitlines(), str(self.source(original)).splitlines(), strict=False)
        old, new = next((a.strip(), b.strip()) for a, b in pairs if a != b)
        return f'{old}  ->  {new}'


def silent_parts(source: str) -> list[tuple[Place, Place]]:
    """
    Return where the annotations of functions and of their locals begin and end.

    They are never evaluated (`from __future__ import annotations`), so that no mutant there can
    behave in another way; those of classes stay, as configurations are made from them.
    """
    found: list[ast.expr | None] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found.append(node.returns)
            found += [part.annotation for part in ast.walk(node.args) if isinstance(part, ast.arg)]
            found += [
                part.annotation for part in ast.walk(node) if isinstance(part, ast.AnnAssign)
            ]
    return [
        ((part.lineno, part.col_offset), (part.end_lineno or 0, part.end_col_offset or 0))
        for part in found
        if part is not None
    ]


def mutants_of(path: Path, root: Path) -> Iterator[Mutant]:
    """Yield every mutant of a file, but for those in annotations of functions."""
    source = path.read_text(encoding='utf-8')
    silent, tree = silent_parts(source), get_ast(source)
    for name in operator_names():
        operator = get_operator(name)
        if operator.arguments():
            continue
        positions = (
            start for node in ast_nodes(tree) for start, _ in operator().mutation_positions(node)
        )
        for occurrence, start in enumerate(positions):
            if not any(first <= start < last for first, last in silent):
                yield Mutant(path.relative_to(root).as_posix(), name, occurrence, start[0])


def sample(mutants: list[Mutant], size: int, seed: int, root: Path) -> list[Mutant]:
    """Return mutants drawn evenly and without repetition, all of them valid Python."""
    drawn: list[Mutant] = []
    for mutant in random.Random(seed).sample(mutants, len(mutants)):
        if len(drawn) == size:
            break
        if mutant.source((root / mutant.path).read_text(encoding='utf-8')) is not None:
            drawn.append(mutant)
    return drawn
