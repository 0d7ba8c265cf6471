"""Pictures of results can be read."""

from __future__ import annotations

from itertools import combinations

from shepherd_ros.controllers import CONTROLLERS
from shepherd_ros.paper.figures import style_of
from shepherd_ros.policy.checkpoint import shipped_checkpoints


def test_each_method_of_a_picture_has_a_marker_of_its_own() -> None:
    policies = [f'policy:{name}' for name in shipped_checkpoints()]
    assert len(policies) > 4
    names = [*policies, 'unknown', *(name for name in CONTROLLERS if name != 'policy')]
    looks = [style_of(name, names) for name in names]
    for one, other in combinations(looks, 2):
        assert one['marker'] != other['marker']
