"""Pictures of results can be read."""

from __future__ import annotations

from itertools import combinations

from shepherd_ros.paper.figures import style_of, STYLES
from shepherd_ros.policy.checkpoint import shipped_checkpoints


def test_each_method_of_a_picture_has_a_marker_of_its_own() -> None:
    policies = [f'policy:{name}' for name in shipped_checkpoints()]
    assert len(policies) > 4
    looks = [style_of(name, policies) for name in [*policies, *STYLES]]
    for one, other in combinations(looks, 2):
        assert one['marker'] != other['marker']
