"""The console against a running graph, with tornado's client as its page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from console.pages_of_tests import TestPage
from nodes.process import Graph
import numpy as np
import pytest
from shepherd_ros.console.messages import MESSAGE_KINDS


@pytest.fixture(scope='module')
def console(shared_graph: Graph) -> Any:
    """Run a small world with its lidar, metrics, a controller and a console."""
    shared_graph.host('flock_sim', n_sheep=12, n_shepherds=2, episode_steps=100_000)
    shared_graph.host('lidar', n_rays=32, shepherd_ids=[0, 1])
    shared_graph.host('metrics')
    shared_graph.host('strombom')
    node = shared_graph.host('console', port=0)
    shared_graph.until(lambda: node.address, 'the console listens')
    return node


@pytest.fixture
def page(shared_graph: Graph, console: Any) -> Iterator[TestPage]:
    """Open a page."""
    opened = TestPage(console.address)
    yield opened
    opened.close()


def test_a_page_gets_what_the_world_says(shared_graph: Graph, page: TestPage) -> None:
    track = shared_graph.track()
    page.send('watch', shepherd=1)
    shared_graph.until(lambda: page.frames and page.frames[-1].lidar == 1, 'a frame with ranges')
    shared_graph.until(
        lambda: any(round(f.time * 1e9) in track.stamps for f in page.frames), 'the same states'
    )
    shared_graph.forget(track)
    for frame in page.frames:
        ns = round(frame.time * 1e9)
        if ns in track.stamps:
            np.testing.assert_array_equal(frame.sheep, track.sheep(ns).numpy())
            np.testing.assert_array_equal(frame.shepherds, track.shepherds(ns).numpy())
    assert page.frames[-1].ranges.shape == (3, 32)
    steps = [frame.step for frame in page.frames]
    assert steps == sorted(set(steps))


def test_a_late_page_gets_what_is_latched(shared_graph: Graph, page: TestPage) -> None:
    latched = ('episode', 'metrics', 'diagnostics', 'pages')
    shared_graph.until(lambda: all(map(page.last, latched)), 'all latched messages')
    late = TestPage(page.address)
    shared_graph.until(lambda: late.frames and all(map(late.last, latched)), 'the same again')
    assert late.order[0] == 'hello'
    assert late.last('episode') == page.last('episode')
    assert late.last('hello')['page'] != page.last('hello')['page']
    shared_graph.until(lambda: page.last('pages')['count'] == 2, 'two pages')
    late.close()
    shared_graph.until(lambda: page.last('pages')['count'] == 1, 'one page')
    assert set(page.order) - {'frame'} <= MESSAGE_KINDS.keys()
