"""No message ends a node: whatever comes on a topic is heard, or dropped and counted."""

from __future__ import annotations

from contextlib import suppress
import gc
import json
from pathlib import Path
import random
import tracemalloc
from types import SimpleNamespace

from geometry_msgs.msg import PoseArray
from jsonschema import Draft202012Validator
from nodes.process import Graph
import pytest
from ros.fuzz import episode, listening, speak
from shepherd_ros.config import ConfigError
from shepherd_ros.resources import share_file
from shepherd_ros.sim.world import WorldConfig
from shepherd_ros.wire.episode import Episode


def test_no_message_ends_a_node_and_memory_stays_flat(
    graph: Graph, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF')
    with listening(tmp_path) as nodes:
        rng = random.Random(0)
        speak(nodes, rng, 1000)
        tracemalloc.start()
        traced = []
        for _ in range(2):
            total = speak(nodes, rng, 1000)
            _ = gc.collect()
            traced.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
        assert traced[1] - traced[0] < total / 3, 'the index of the bag grows, and nothing else'
        assert sum(node.unreadable.total() for node in nodes) > 100


def test_an_episode_is_never_more_than_its_schema_allows() -> None:
    schema = json.loads(share_file('msg_schemas', 'episode.schema.json').read_text())
    validator, rng, taken = Draft202012Validator(schema), random.Random(0), 0
    for _ in range(3000):
        text = episode(rng)
        with suppress(ConfigError):
            WorldConfig.from_dict(Episode.from_json(text).world)
            taken += 1
            for error in validator.iter_errors(json.loads(text)):
                # an option of the world that is left out has its default
                assert (error.validator, error.path[0]) == ('required', 'world'), error
    assert taken > 500


def test_what_cannot_be_read_is_dropped_counted_and_warned_of(graph: Graph) -> None:
    graph.listen_to_logs()
    node = graph.host('metrics')
    output = graph.publisher('flock/poses', PoseArray)
    for raw in (b'\0\1\0\0ab', b'\0\1\0\0' + bytes(8) + b'\4\0\0\0m\xfcp\0' + bytes(4)):
        output.publish(raw)
    graph.until(lambda: node.unreadable['flock/poses'] == 2, 'both are counted')
    graph.until(lambda: graph.warnings('flock/poses has a message that cannot be read'), 'said')
    status = graph.until_status('metrics: inputs', 'cannot be read: flock/poses')
    assert (status.level, status.values[0].value) == (b'\1', '2')


def test_a_flood_of_what_cannot_be_read_is_logged_at_intervals(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, logged = graph.host('metrics'), list[float]()
    logger = SimpleNamespace(
        warning=lambda text, *, throttle_duration_sec: logged.append(throttle_duration_sec)
    )
    monkeypatch.setattr(node, 'get_logger', lambda: logger)
    (poses,) = (s for s in node.subscriptions if s.topic_name == '/flock/poses')
    for _ in range(100):
        poses.callback(b'\0\1\0\0ab')
    assert node.unreadable == {'flock/poses': 100}
    assert len(logged) == 100
    assert min(logged) >= 1.0
