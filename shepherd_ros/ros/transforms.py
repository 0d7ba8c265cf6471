"""The shepherds' frames on /tf, where tf2_msgs is installed (it comes with ROS, not from PyPI)."""

from __future__ import annotations

from geometry_msgs.msg import TransformStamped
from shepherd_ros.ros.node import ShepherdNode, stamp
from shepherd_ros.wire.topics import SHEPHERD
from torch import Tensor

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None


def shepherd_transforms(
    ns: int, world: str, shepherds: Tensor, frame: str = SHEPHERD
) -> list[TransformStamped]:
    """Return the transform from the world to each shepherd's frame, without rotation."""
    transforms = []
    for h, (x, y) in enumerate(shepherds.tolist()):
        transform = TransformStamped(child_frame_id=frame.format(h=h))
        transform.header.stamp, transform.header.frame_id = stamp(ns), world
        transform.transform.translation.x, transform.transform.translation.y = x, y
        transform.transform.rotation.w = 1.0
        transforms.append(transform)
    return transforms


class TransformOutput:
    """Publishes the shepherds' frames, so that viewers can place their scans."""

    def __init__(self, node: ShepherdNode) -> None:
        """Advertise /tf, if its type is installed."""
        self.node = node
        self.publisher = (
            None if TFMessage is None else node.create_publisher(TFMessage, '/tf', 100)
        )

    def publish(self, ns: int, shepherds: Tensor) -> None:
        """Publish the positions of the shepherds, (H, 2) m, if /tf has a subscriber."""
        if self.publisher is not None and self.publisher.get_subscription_count():
            frames = self.node.frame_id, shepherds, self.node.shepherd_frame
            self.publisher.publish(TFMessage(transforms=shepherd_transforms(ns, *frames)))
