"""The network: its size, its fast form against the plain one, what it does not depend on."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.policy.fast_conv import first_stage, plain_stage, second_stage
from shepherd_ros.policy.network import Actor, Body, Critic, NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.observation import ObservationConfig
import torch
from torch import nn, Tensor

PAPER = (3, 1536)
RING = (9, 512)


def sparse_input(batch: int, shape: tuple[int, int], seed: int = 0) -> Tensor:
    """Return an input like a lidar's: mostly zero, with equal neighbours."""
    generator = torch.Generator().manual_seed(seed)
    x = torch.rand(batch, *shape, generator=generator)
    return x * (torch.rand(batch, *shape, generator=generator) < 0.3)


def parameters(network: nn.Module) -> int:
    return sum(p.numel() for p in network.parameters())


def test_the_networks_have_the_size_that_the_paper_draws() -> None:
    body = 32 * 3 * 10 + 32 + 64 * 32 * 10 + 64 + 3776 * 512 + 512
    assert parameters(Critic(PAPER, NetworkConfig())) == body + 513 == 1_955_873
    assert parameters(Actor(PAPER, NetworkConfig())) == body + 4 * 513
    assert parameters(Actor(PAPER, NetworkConfig(std_type='free'))) == body + 2 * 513 + 2


@pytest.mark.parametrize(
    ('shape', 'config'),
    [
        (PAPER, NetworkConfig()),
        (RING, NetworkConfig(padding='circular')),
        ((3, 79), NetworkConfig(filters_1=3, filters_2=5, hidden=7)),
    ],
    ids=['paper', 'ring', 'smallest'],
)
def test_the_fast_form_is_the_plain_one_with_its_gradients(
    shape: tuple[int, int], config: NetworkConfig
) -> None:
    torch.manual_seed(1)
    body = Body(shape, config)
    for parameter in body.parameters():
        parameter.data += 0.01 * torch.randn_like(parameter)  # biases too
    x = sparse_input(5, shape)
    weights = torch.randn(5, config.hidden)
    fast, plain = body(x), body.plain(x)
    torch.testing.assert_close(fast, plain, atol=1e-5, rtol=1e-4)
    names = [name for name, _ in body.named_parameters()]
    result = torch.autograd.grad((fast * weights).sum(), list(body.parameters()))
    expected = torch.autograd.grad((plain * weights).sum(), list(body.parameters()))
    for name, a, b in zip(names, result, expected, strict=True):
        scale = float(b.abs().max())
        assert scale > 0, name
        assert float((a - b).abs().max()) < 2e-3 * scale, name


def test_the_form_in_bfloat16_is_near_the_plain_one() -> None:
    torch.manual_seed(2)
    body = Body(PAPER, NetworkConfig())
    x = sparse_input(8, PAPER)
    with torch.no_grad():
        plain, short = body.plain(x), body(x.bfloat16()).float()
    assert float((short - plain).abs().max()) < 0.02 * float(plain.abs().max())


@pytest.mark.parametrize('stage', [first_stage, second_stage])
def test_a_stage_is_convolution_relu_and_pooling_by_hand(stage) -> None:
    # one channel, a filter that takes the first of its ten values, minus two
    x = torch.tensor([[3.0, 1, 4, 1, 5, 9, 2, 6, 5, 3, 5, 8, 9, 7, 9, 3, 2, 3, 8]])[..., None]
    weight = torch.zeros(1, 1, 10)
    weight[0, 0, 0] = 1.0
    # ten outputs, pooled by five: max(3 1 4 1 5) - 2 and max(9 2 6 5 3) - 2
    assert stage(x, weight, torch.tensor([-2.0])).flatten().tolist() == [3.0, 7.0]
    assert stage(x, weight, torch.tensor([-6.0])).flatten().tolist() == [0.0, 3.0]
    plain = plain_stage(x.transpose(1, 2), weight, torch.tensor([-2.0]))
    assert plain.flatten().tolist() == [3.0, 7.0]


def test_of_equal_values_the_first_gets_the_gradient_and_below_zero_nobody() -> None:
    x = torch.ones(1, 19, 1)
    weight = torch.zeros(1, 1, 10)
    for bias, expected in ((0.5, 2.0), (0.0, 0.0), (-1.0, 0.0)):
        given = torch.tensor([bias], requires_grad=True)
        first_stage(x, weight, given).sum().backward()
        assert given.grad is not None
        assert given.grad.item() == expected


def test_a_ring_has_no_first_ray() -> None:
    torch.manual_seed(3)
    body = Body((9, 100), NetworkConfig(padding='circular', filters_1=4, filters_2=4, hidden=8))
    x = sparse_input(2, (9, 100))
    # behind the second pooling, a turn of the input by 25 rays is a turn by one place
    seen: list[Tensor] = []
    body.dense.register_forward_pre_hook(lambda layer, given: seen.append(given[0]))
    body.plain(x)
    body.plain(x.roll(25, dims=-1))
    places = [y.unflatten(1, (4, 4)) for y in seen]  # (2, place, filter)
    torch.testing.assert_close(places[0].roll(1, dims=1), places[1])
    assert not torch.allclose(places[0], places[1])


@pytest.mark.parametrize(
    ('layout', 'spread'), product(['types', 'frames', 'ring'], ['state', 'free'])
)
def test_every_layout_and_spread_gives_finite_actions(layout: str, spread: str) -> None:
    config = PolicyConfig(
        observation=ObservationConfig(layout=layout, align='goal'),
        network=NetworkConfig(std_type=spread, init_std=0.4),
    )
    torch.manual_seed(0)
    policy = Policy(config)
    frames = torch.full((3, 3, 3, 512), torch.inf)
    frames[1:, ..., :40] = 5.0
    first = policy.first_ray(frames[:, -1])
    mean, std = policy.actor(policy.arrange(policy.scale(frames), first))
    assert mean.shape == std.shape == (3, 2)
    assert mean.abs().max() < 0.1  # nearly no motion before training
    assert torch.allclose(std, torch.full_like(std, 0.4), rtol=0.1)
    assert policy.act(frames).isfinite().all()
    assert policy.act(frames[:0]).shape == (0, 2)


def test_sizes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ConfigError, match=r'frame_interval is 1.5 s: .* decision_interval, 1.0 s'):
        PolicyConfig(decision_interval=1.0, observation=ObservationConfig(frame_interval=1.5))
    with pytest.raises(ConfigError, match="layout is 'types': expected ring"):
        PolicyConfig(network=NetworkConfig(padding='circular'))
    with pytest.raises(ConfigError, match='expected 79 or more'):
        Body((3, 78), NetworkConfig())


def test_a_policy_with_another_configuration_shares_weights_and_leaves_the_first_alone() -> None:
    config = PolicyConfig(network=NetworkConfig(filters_1=3, filters_2=5, hidden=7))
    policy = Policy(config)
    wide = replace(
        config, decision_interval=0.25, network=replace(config.network, min_std=1.2, max_std=1.3)
    )
    other = policy.with_config(wide)
    assert (policy.config, policy.actor.config) == (config, config.network)
    assert (other.config, other.actor.config) == (wide, wide.network)
    for name, own in policy.named_parameters():
        assert other.get_parameter(name) is own
    x = sparse_input(4, PAPER)
    (mean, std), (other_mean, other_std) = policy.actor(x), other.actor(x)
    assert torch.equal(mean, other_mean)
    assert torch.equal(other_std, std.clamp(1.2, 1.3))
