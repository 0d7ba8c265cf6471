"""Metrics and diagnostics of a running graph, as the console tells them."""

from __future__ import annotations

from contextlib import suppress
import math
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from shepherd_ros.ros.node import ShepherdNode
from shepherd_ros.ros.polling import PolledGroup, PolledTopic
from shepherd_ros.wire.contract import known
from shepherd_ros.wire.decode import CdrError, decode_float64
from shepherd_ros.wire.topics import metric_topic, row_of

FAMILY = metric_topic('').rstrip('/')
DIAGNOSTICS_KEPT = 64  # messages on /diagnostics between two looks
SILENT_NODE = 10.0  # [s] after which the report of a node is left out


class ConsoleReports:
    """Newest metrics of the episode and newest report of each part of each node."""

    def __init__(self, node: ShepherdNode, group: PolledGroup) -> None:
        """Subscribe to reports; look_for_metrics() finds metrics."""
        self.node, self.group = node, group
        self.reports = PolledTopic(node, group, '/diagnostics', depth=DIAGNOSTICS_KEPT)
        self.metrics: dict[str, PolledTopic] = {}
        self.values: dict[str, float] = {}
        self.statuses: dict[str, tuple[float, dict[str, Any]]] = {}

    def look_for_metrics(self) -> None:
        """Subscribe to the metrics that are published; in the executor's thread."""
        space = self.node.get_namespace().rstrip('/')
        for name, _ in self.node.get_topic_names_and_types():
            entry = known(name)
            if entry is None or entry.namespace != space:
                continue
            family, _, metric = entry.topic.name.partition('/')
            if family == FAMILY and metric not in self.metrics:
                self.metrics[metric] = PolledTopic(self.node, self.group, entry.topic.name)

    def metric_names(self) -> list[dict[str, str]]:
        """Return name, unit and meaning of each metric that is published."""
        rows = {name: row_of(metric_topic(name)) for name in sorted(self.metrics)}
        return [{'name': n, 'unit': r.unit, 'meaning': r.meaning} for n, r in rows.items()]

    def hear_metrics(self) -> bool:
        """Take the newest metrics; return whether there are any."""
        changed = False
        for name, topic in list(self.metrics.items()):
            for raw in topic.take()[-1:]:
                with suppress(CdrError):
                    value = decode_float64(raw)
                    if math.isfinite(value):
                        self.values[name], changed = value, True
        return changed

    def hear_reports(self) -> list[dict[str, Any]]:
        """Return the newest report of each part of each node, sorted by name."""
        now = self.node.wall()
        for raw in self.reports.take():
            for status in deserialize_message(raw, DiagnosticArray).status:
                self.statuses[status.name] = (
                    now,
                    {
                        'name': status.name,
                        'level': status.level[0],
                        'message': status.message,
                        'values': {item.key: item.value for item in status.values},
                    },
                )
        for name in [n for n, (then, _) in self.statuses.items() if now - then > SILENT_NODE]:
            del self.statuses[name]
        return [report for _, (_, report) in sorted(self.statuses.items())]
