"""The frames of the shepherds, as they go to /tf."""

from shepherd_ros.ros.node import nanoseconds
from shepherd_ros.ros.transforms import shepherd_transforms
import torch


def test_a_frame_stands_where_its_shepherd_is_and_never_turns() -> None:
    transforms = shepherd_transforms(1_500_000_000, 'map', torch.tensor([[1.0, 2.0], [-3.0, 0.5]]))
    assert [t.child_frame_id for t in transforms] == ['shepherd_0', 'shepherd_1']
    assert {t.header.frame_id for t in transforms} == {'map'}
    assert {nanoseconds(t.header.stamp) for t in transforms} == {1_500_000_000}
    moves = [(t.transform.translation.x, t.transform.translation.y) for t in transforms]
    assert moves == [(1.0, 2.0), (-3.0, 0.5)]
    turns = [t.transform.rotation for t in transforms]
    assert [(q.x, q.y, q.z, q.w) for q in turns] == [(0.0, 0.0, 0.0, 1.0)] * 2
