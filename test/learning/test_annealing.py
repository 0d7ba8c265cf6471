"""Actions are held for shorter and shorter, with the same weight of a second."""

from __future__ import annotations

import pytest
from shepherd_ros.config import ConfigError
from shepherd_ros.learning.annealing import AnnealConfig, discount, stage_at, stages
from shepherd_ros.policy.network import NetworkConfig
from shepherd_ros.policy.policy import PolicyConfig
from shepherd_ros.sim.observation import ObservationConfig

FIRST = PolicyConfig(
    decision_interval=4.0,
    observation=ObservationConfig(frame_interval=4.0),
    network=NetworkConfig(min_std=0.4),
)


def test_the_time_is_halved_down_to_the_last() -> None:
    found = stages(FIRST, AnnealConfig(final_decision_interval=0.5, final_min_std=0.05))
    assert [stage.decision_interval for stage in found] == [4.0, 2.0, 1.0, 0.5]
    # the floor of the spread falls by the same factor at each stage, 0.4 / 0.05 = 2 ** 3
    assert [stage.network.min_std for stage in found] == pytest.approx([0.4, 0.2, 0.1, 0.05])
    assert [stage.timing(0.5).frames.spacing for stage in found] == [1, 2, 4, 8]
    assert stages(FIRST, AnnealConfig(final_decision_interval=4.0)) == [FIRST]


def test_a_policy_of_one_step_has_one_stage() -> None:
    assert len(stages(PolicyConfig(), AnnealConfig())) == 1


@pytest.mark.parametrize('last', [1.5, 2.5])
def test_an_end_that_halving_misses_is_refused(last: float) -> None:
    refusal = f'final_decision_interval is {last} s: .* decision_interval, 4.0 s, comes to'
    with pytest.raises(ConfigError, match=refusal):
        stages(FIRST, AnnealConfig(final_decision_interval=last))


def test_stages_share_what_the_first_leaves() -> None:
    config = AnnealConfig(anneal_start=0.4)
    shares = (0.0, 0.39, 0.4, 0.59, 0.61, 0.79, 0.81, 0.999, 1.0)
    assert [stage_at(share, 4, config) for share in shares] == [0, 0, 1, 1, 2, 2, 3, 3, 3]
    assert stage_at(0.9, 1, config) == 0
    assert stage_at(0.99, 4, AnnealConfig(anneal_start=1.0)) == 0


def test_a_second_weighs_the_same_however_long_an_action_is_held() -> None:
    for dt in (0.1, 0.2, 0.5, 1.0):
        assert discount(0.9, FIRST.timing(dt)) == pytest.approx(0.9)  # 4 s
        for stage in stages(FIRST, AnnealConfig()):
            timing = stage.timing(dt)
            eight_seconds = 8 / (timing.action_repeat * dt)  # decisions
            assert discount(0.9, timing) ** eight_seconds == pytest.approx(0.9**2)
