"""Functions that torch compiles for a GPU: compiled whole, equal to their laws, and only there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from reference import batch, make_state
from shepherd_ros.policy.fast_conv import plain_stage
from shepherd_ros.sim import fused as module
from shepherd_ros.sim.flocking import reynolds_flock, strombom_flock
from shepherd_ros.sim.flocking.reynolds_flock import ReynoldsFlock
from shepherd_ros.sim.flocking.strombom_flock import StrombomFlock
from shepherd_ros.sim.fused import fused
from shepherd_ros.sim.lidar import cast_all_rays
import torch


def works() -> dict[str, tuple[Callable[..., Any], tuple[Any, ...]]]:
    """Return each compiled law with arguments for it."""
    state = batch([make_state(seed, 40, 3) for seed in range(4)])
    flock = (state.sheep, state.sheep_mask, state.shepherds, state.shepherd_mask)
    discs = (
        state.shepherds,
        state.sheep[:, None],
        torch.tensor(0.5).double(),
        state.sheep_mask[:, None],
    )
    return {
        'strombom, farthest': (strombom_flock.forces, (*flock, StrombomFlock(n_neighbors=30))),
        'strombom, nearest': (strombom_flock.forces, (*flock, StrombomFlock(n_neighbors=5))),
        'reynolds': (reynolds_flock.steered, (state.sheep, state, ReynoldsFlock(), 0.5)),
        'network': (plain_stage, (torch.randn(5, 3, 64), torch.randn(8, 3, 10), torch.randn(8))),
        'lidar': (cast_all_rays, (*discs, 64, 75.0)),
        'lidar, facing': (cast_all_rays, (*discs, 64, 75.0, True, True)),
    }


@pytest.mark.parametrize('name', works())
def test_a_law_is_one_graph_and_means_the_same(name: str) -> None:
    law, arguments = works()[name]
    graph = torch.compile(law.__wrapped__, fullgraph=True, backend='aot_eager')
    torch.testing.assert_close(graph(*arguments), law(*arguments), rtol=1e-6, atol=1e-6)


def test_the_gradient_of_a_compiled_stage_is_that_of_the_plain_one() -> None:
    draw = torch.Generator().manual_seed(0)
    shapes = ((5, 3, 64), (8, 3, 10), (8,))
    arguments = [torch.randn(shape, generator=draw).requires_grad_() for shape in shapes]
    graph = torch.compile(plain_stage.__wrapped__, fullgraph=True, backend='aot_eager')
    own = torch.autograd.grad(graph(*arguments).square().sum(), arguments)
    wanted = torch.autograd.grad(plain_stage(*arguments).square().sum(), arguments)
    torch.testing.assert_close(own, wanted)


def test_only_tensors_on_a_gpu_make_torch_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    requested: list[str] = []

    def compile_it(function: Callable[..., Any]) -> Callable[..., Any]:
        requested.append(function.__name__)
        return function

    @fused
    def twice(x: torch.Tensor, factor: int) -> torch.Tensor:
        return x * factor

    monkeypatch.setattr(torch, 'compile', compile_it)
    assert twice(torch.ones(1), 2) == 2
    assert requested == []
    monkeypatch.setattr(module, 'fusible', lambda tensor: True)
    assert twice(torch.ones(1), 2) == twice(torch.ones(2), 2)[0] == 2
    assert requested == ['twice']
