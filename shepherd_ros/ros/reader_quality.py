"""Quality of service of a subscription to topics of any publishers."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


def reader_quality(reliable: bool, latched: bool, depth: int) -> QoSProfile:
    """Return the quality of service of a subscription in which depth messages may wait."""
    return QoSProfile(
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def adapted_quality(offers: Iterable[QoSProfile], depth: int) -> QoSProfile:
    """Return the strictest quality of service that all publishers of a topic satisfy."""
    offers = list(offers)
    reliable = all(o.reliability == ReliabilityPolicy.RELIABLE for o in offers)
    latched = all(o.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in offers)
    return reader_quality(reliable, latched, depth)
