"""
The statements of section 5 of the paper, figure by figure; RL is a policy of ours.

`better` names the side of a number's bounds on which it is better for the user: see Clause. It
was chosen from the text of the paper alone.
"""

from __future__ import annotations

from shepherd_ros.paper.claims import Claim
from shepherd_ros.paper.size_statements import SIZE_STATEMENTS
from shepherd_ros.paper.world_statements import WORLD_STATEMENTS

CLAIMS = tuple(
    Claim(figure, text, clauses)
    for figure, statements in (SIZE_STATEMENTS | WORLD_STATEMENTS).items()
    for text, clauses in statements.items()
)
