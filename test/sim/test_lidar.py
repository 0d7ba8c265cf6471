"""The lidar: against every ray with every disc, and by hand."""

from __future__ import annotations

from dataclasses import replace
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from reference import assert_near, batch, lidar, make_state, moved, padded, state_of, World
from shepherd_ros.config import ConfigError
from shepherd_ros.sim import compiled
from shepherd_ros.sim.lidar import cast_rays, CONTACT_RANGE, LidarConfig, scan
from shepherd_ros.sim.lidar_layout import PAPER_CHANNELS
from shepherd_ros.sim.state import WorldState
import torch
from torch import Tensor

SHEEP, SHEPHERDS, GOAL = 0, 1, 2
NONE = math.inf


def scene(seed: int) -> tuple[WorldState, LidarConfig]:
    """Return a world that is dense or sparse, small or wider than the lidar sees, and a lidar."""
    rng = np.random.default_rng(seed)
    state = make_state(
        seed,
        int(rng.choice([1, 2, 10, 50])),
        int(rng.choice([1, 2, 3, 8])),
        spread=float(rng.choice([0.5, 3.0, 20.0, 60.0])),
        reach=float(rng.choice([1.0, 8.0, 40.0, 100.0])),
        goal_radius=float(rng.uniform(0.3, 12.0)),
    )
    config = LidarConfig(
        n_rays=int(rng.choice([4, 16, 100, 512])),
        range_max=float(rng.choice([10.0, 75.0])),
        sheep_radius=float(rng.choice([0.05, 0.5, 2.0])),
        shepherd_radius=float(rng.choice([0.05, 0.5, 2.0])),
        cross_occlusion=bool(rng.integers(0, 2)),
    )
    return state, config


def ray_scene(dtype: torch.dtype = torch.float64) -> WorldState:
    """Return two shepherds on the x axis with a sheep ahead of each."""
    return state_of([[5.0, 0.0], [20.0, 0.0]], [[0.0, 0.0], [10.0, 0.0]], goal=[0.0, 30.0]).to(
        dtype
    )


# --- against the reference ----------------------------------------------------------------------


@pytest.mark.parametrize('form', ['as it runs here', 'as on a GPU'])
@pytest.mark.parametrize('dtype', [torch.float64, torch.float32], ids=str)
def test_two_hundred_scenes_are_those_of_every_ray_with_every_disc(
    monkeypatch: pytest.MonkeyPatch, dtype: torch.dtype, form: str
) -> None:
    if form == 'as on a GPU':
        monkeypatch.setattr(compiled, 'HAS_NUMBA', False)
        monkeypatch.setattr('shepherd_ros.sim.lidar.fusible', lambda tensor: True)
    # left out: rays that pass within `margin` of a disc's edge, ranges so near the greatest range,
    # and sensors so near a rim, where a rounding decides between a range and none
    margin, tolerance = (1e-6, 1e-9) if dtype == torch.float64 else (2e-3, 5e-4)
    compare_samples = left_out = seen = 0
    for seed in range(200):
        state, config = scene(seed)
        result = scan(state.to(dtype), config).double().numpy()
        world = World.of(state)
        for me in range(len(world.shepherds)):
            expected, unsure = lidar(world, me, config, margin)
            np.testing.assert_allclose(
                result[me][~unsure],
                expected[~unsure],
                rtol=0,
                atol=tolerance,
                err_msg=f'scene {seed}, shepherd {me}',
            )
            compare_samples += unsure.size - unsure.sum()
            left_out += unsure.sum()
            seen += np.isfinite(expected).sum()
    assert left_out < (0.001 if dtype == torch.float64 else 0.03) * compare_samples
    assert seen > 0.05 * compare_samples


def test_a_scan_of_a_thousand_sheep_by_twenty_shepherds_is_the_reference() -> None:
    state, config = make_state(9, 1000, 20, spread=15.0, reach=60.0), LidarConfig()
    result = scan(state, config).numpy()
    for me in (0, 7, 19):
        expected, unsure = lidar(World.of(state), me, config, 1e-6)
        np.testing.assert_allclose(result[me][~unsure], expected[~unsure], rtol=0, atol=1e-5)


def test_float32_sees_what_float64_sees_but_for_grazed_edges() -> None:
    state = make_state(10, 100, 3, reach=30.0)
    double = scan(state, LidarConfig())
    single = scan(state.to(torch.float32), LidarConfig()).double()
    same = (double == single) | ((double - single).abs() < 1e-3)
    assert same.double().mean() > 0.995


# --- by hand ------------------------------------------------------------------------------------


def cast(centers: list[list[float]], radius: float = 0.5, **options: object) -> Tensor:
    points = torch.tensor(centers, dtype=torch.float64).reshape(-1, 2)
    values = {'n_rays': 16, 'range_max': 75.0, 'solid': True, **options}
    return cast_rays(
        torch.zeros(2, dtype=torch.float64),
        points,
        torch.full((len(points),), radius, dtype=torch.float64),
        torch.ones(len(points), dtype=torch.bool),
        **values,
    )


def only(n_rays: int, **hits: float) -> Tensor:
    expected = torch.full((n_rays,), NONE, dtype=torch.float64)
    for name, value in hits.items():
        expected[int(name[3:])] = value
    return expected


def test_a_disc_straight_ahead_is_seen_at_its_near_edge() -> None:
    assert_near(cast([[10.0, 0.0]]), only(16, ray0=9.5), 1e-9)
    assert_near(cast([[0.0, 10.0]]), only(16, ray4=9.5), 1e-9)
    assert_near(cast([[-10.0, 0.0]]), only(16, ray8=9.5), 1e-9)
    assert_near(cast([[0.0, -10.0]]), only(16, ray12=9.5), 1e-9)


def test_a_ray_off_the_middle_meets_the_disc_later() -> None:
    # 0.3 beside the middle of a disc of radius 0.5 the edge is 0.4 nearer than the middle
    assert_near(cast([[10.0, 0.3]]), only(16, ray0=9.6), 1e-9)
    assert_near(cast([[10.0, -0.3]]), only(16, ray0=9.6), 1e-9)


def test_a_disc_across_ray_zero_is_seen_by_rays_on_both_sides() -> None:
    # at 2 m a disc of 0.9 m covers 26.7 degrees to either side: rays 0, 1 and 15 of 16
    side = 2 * math.cos(math.pi / 8)
    side -= math.sqrt(0.81 - (2 * math.sin(math.pi / 8)) ** 2)
    expected = only(16, ray0=1.1, ray1=side, ray15=side)
    assert_near(cast([[2.0, 0.0]], radius=0.9), expected, 1e-9)


def test_a_small_disc_between_two_rays_is_seen_by_none() -> None:
    angle = math.pi / 16
    assert not cast([[20 * math.cos(angle), 20 * math.sin(angle)]]).isfinite().any()


def test_at_512_rays_no_body_within_range_is_missed() -> None:
    angle = torch.rand(300, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    for a in (angle * 2 * math.pi).tolist():
        assert cast([[75 * math.cos(a), 75 * math.sin(a)]], n_rays=512).isfinite().any()


def test_of_two_discs_on_a_ray_the_nearer_is_seen() -> None:
    assert_near(cast([[30.0, 0.0], [10.0, 0.0], [20.0, 0.0]]), only(16, ray0=9.5), 1e-9)


def test_nothing_is_seen_where_there_is_nothing() -> None:
    assert not cast([]).isfinite().any()
    assert cast([]).shape == (16,)


def test_a_disc_just_beyond_the_greatest_range_is_not_seen_and_one_just_within_is() -> None:
    assert_near(cast([[75.49, 0.0]]), only(16, ray0=74.99), 1e-9)
    assert not cast([[75.51, 0.0]]).isfinite().any()


def test_a_body_that_overlaps_the_sensor_touches_on_every_ray() -> None:
    assert CONTACT_RANGE == 0.01
    for center in ([0.0, 0.0], [0.3, -0.2], [0.0, 0.499]):
        assert_near(cast([center]), torch.full((16,), 0.01), 1e-9)


@pytest.mark.parametrize(
    ('center', 'rays'),
    [
        ([0.3, -0.2], {11, 12, 13, 14, 15, 0, 1, 2}),  # at -34 degrees: -124 to 56
        ([0.0, 0.499], set(range(9))),  # at 90 degrees: 0 to 180, those across too
        ([-0.1, 0.0], set(range(4, 13))),
        ([0.0, 0.0], set(range(16))),  # in its very middle there is no direction
    ],
)
def test_a_body_that_overlaps_the_sensor_may_touch_only_on_rays_that_face_it(
    center: list[float], rays: set[int]
) -> None:
    expected = only(16, **{f'ray{k}': CONTACT_RANGE for k in rays})
    assert_near(cast([center], facing=True), expected, 1e-9)
    rim = cast([[1.0, 0.0]], radius=4.0, solid=False)  # which is no body
    assert_near(cast([[1.0, 0.0]], radius=4.0, solid=False, facing=True), rim, 1e-9)


def test_rays_that_face_a_body_are_those_that_see_it_from_its_rim() -> None:
    outside, inside = (cast([[x, 0.0]], n_rays=512, facing=True) for x in (0.50001, 0.49999))
    assert int((outside.isfinite() != inside.isfinite()).sum()) <= 2  # those that graze it
    assert int(inside.isfinite().sum()) == 257


def test_shepherds_that_overlap_see_each_other_on_opposite_sides() -> None:
    state = make_state(0, 1, 2, dtype=torch.float32)
    state.shepherds[:] = torch.tensor([[0.2, 0.1], [-0.2, 0.1]])
    state.sheep[:] = 30.0
    blind, seeing = (scan(state, LidarConfig(contact=name))[:, 1] for name in ('all', 'facing'))
    assert torch.equal(blind[0], blind[1])
    left, right = seeing[1].isfinite(), seeing[0].isfinite()
    assert left[[0, 64, 448]].all() and not left[[129, 256, 383]].any()
    assert torch.equal(right.roll(256), left)


def test_from_inside_the_goal_its_rim_is_seen_all_round() -> None:
    assert_near(cast([[0.0, 0.0]], radius=4.0, solid=False), torch.full((16,), 4.0), 1e-9)
    rim = cast([[1.0, 0.0]], radius=4.0, solid=False)
    assert_near(rim[[0, 8]], [5.0, 3.0], 1e-9)
    assert_near(rim[[4, 12]], [15**0.5, 15**0.5], 1e-9)


def test_the_rim_of_a_goal_too_wide_to_see_is_not_seen() -> None:
    rim = cast([[50.0, 0.0]], radius=60.0, solid=False)
    assert rim[0] == NONE
    assert_near(rim[8], 10.0, 1e-9)


def test_a_mask_takes_discs_away() -> None:
    ranges = cast_rays(
        torch.zeros(2),
        torch.tensor([[5.0, 0.0], [10.0, 0.0]]),
        torch.tensor([0.5, 0.5]),
        torch.tensor([False, True]),
        16,
        75.0,
    )
    assert_near(ranges[0], 9.5, 1e-5)


def test_channels_are_sheep_then_shepherds_then_goal_and_no_shepherd_sees_itself() -> None:
    assert PAPER_CHANNELS == ('sheep', 'shepherds', 'goal')
    ranges = scan(ray_scene(), LidarConfig(n_rays=16))
    assert ranges.shape == (2, 3, 16)
    assert_near(ranges[0, :, 0], [4.5, 9.5, NONE], 1e-9)
    assert_near(ranges[1, :, 0], [9.5, NONE, NONE], 1e-9)
    assert_near(ranges[1, :, 8], [4.5, 9.5, NONE], 1e-9)
    assert_near(ranges[0, :, 4], [NONE, NONE, 26.0], 1e-9)


def test_bodies_hide_others_of_their_own_type_only() -> None:
    state = state_of(
        [[5.0, 0.0], [8.0, 0.0]], [[0.0, 0.0], [20.0, 0.0], [25.0, 0.0]], goal=[40.0, 0.0]
    )
    assert_near(scan(state, LidarConfig())[0, :, 0], [4.5, 19.5, 36.0], 1e-9)


def test_with_cross_occlusion_bodies_hide_all_that_is_behind() -> None:
    config = LidarConfig(cross_occlusion=True)
    state = state_of([[5.0, 0.0]], [[0.0, 0.0], [20.0, 0.0]], goal=[40.0, 0.0])
    assert_near(scan(state, config)[0, :, 0], [4.5, NONE, NONE], 1e-9)
    nearer = replace(state, shepherds=state.shepherds * 0.1)
    assert_near(scan(nearer, config)[0, :, 0], [NONE, 1.5, NONE], 1e-9)


def test_the_goal_hides_nothing_and_its_rim_is_hidden_by_bodies_before_it() -> None:
    config = LidarConfig(cross_occlusion=True)
    behind = state_of([[15.0, 0.0]], [[0.0, 0.0]], goal=[8.0, 0.0])
    assert_near(scan(behind, config)[0, :, 0], [14.5, NONE, 4.0], 1e-9)
    within = state_of([[2.0, 0.0]], [[0.0, 0.0]], goal=[0.0, 0.0])
    assert_near(scan(within, config)[0, :, 0], [1.5, NONE, NONE], 1e-9)
    assert_near(scan(within, config)[0, :, 256], [NONE, NONE, 4.0], 1e-9)


def test_types_have_their_own_radius() -> None:
    config = LidarConfig(sheep_radius=0.2, shepherd_radius=1.5)
    state = state_of([[5.0, 0.0]], [[0.0, 0.0], [20.0, 0.0]])
    assert_near(scan(state, config)[0, :2, 0], [4.8, 18.5], 1e-9)


def test_absent_shepherds_neither_see_nor_are_seen_and_absent_sheep_are_not_seen() -> None:
    state = make_state(3, 20, 3)
    with_absent = padded(state, 5, 2)
    ranges = scan(with_absent, LidarConfig())
    assert torch.equal(ranges[:3], scan(state, LidarConfig()))
    assert not ranges[3:].isfinite().any()


# --- which lidars, which worlds -----------------------------------------------------------------


@pytest.mark.parametrize(
    'config',
    [
        LidarConfig(n_rays=64),
        LidarConfig(n_rays=64, range_noise=0.3, dropout=0.2),
        LidarConfig(n_rays=64, cross_occlusion=True, range_noise=0.3),
    ],
    ids=['clean', 'noisy', 'occluded'],
)
@pytest.mark.parametrize('dtype', [torch.float32, torch.float64], ids=str)
def test_some_shepherds_see_what_they_see_among_all(
    config: LidarConfig, dtype: torch.dtype
) -> None:
    state = batch([make_state(seed, 30, 5) for seed in range(3)]).to(dtype)
    everyone = scan(state, config)
    for some in ([0], [4], [1, 3], [3, 1], [0, 1, 2, 3, 4]):
        assert torch.equal(scan(state, config, torch.tensor(some)), everyone[:, some])


@pytest.mark.parametrize('noise', [0.0, 0.2])
@pytest.mark.parametrize('dtype', [torch.float32, torch.float64], ids=str)
def test_a_batch_of_scans_equals_each_alone_bit_for_bit(noise: float, dtype: torch.dtype) -> None:
    config = LidarConfig(range_noise=noise, dropout=noise)
    states = [make_state(seed, 30, 3).to(dtype) for seed in range(5)]
    together = scan(batch(states), config)
    for index, state in enumerate(states):
        assert torch.equal(together[index], scan(state, config))


def test_mixed_team_and_flock_sizes_in_one_batch_equal_each_alone_bit_for_bit() -> None:
    states = [make_state(n, n, m) for n, m in [(1, 1), (30, 3), (100, 20), (2, 6)]]
    together = scan(batch(states), LidarConfig())
    for index, state in enumerate(states):
        m = len(state.shepherds)
        assert torch.equal(together[index, :m], scan(state, LidarConfig()))
        assert not together[index, m:].isfinite().any()


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 2**31), st.integers(0, 63), st.integers(1, 30), st.integers(1, 5))
def test_turning_the_world_by_some_rays_turns_the_scan_by_as_many(
    seed: int, turn: int, n: int, m: int
) -> None:
    state, config = make_state(seed, n, m), LidarConfig(n_rays=64)
    result = scan(moved(state, 2 * math.pi * turn / 64, (3.0, -7.0)), config)
    expected = scan(state, config).roll(turn, dims=-1)
    off = ~(((result - expected).abs() < 1e-4) | (result == expected))
    assert off.double().mean() < 1e-3  # an edge may be grazed


@pytest.mark.parametrize('dtype', [torch.float32, torch.float64], ids=str)
def test_a_degenerate_world_is_seen_without_nan(dtype: torch.dtype) -> None:
    point = torch.tensor([1.0, 2.0], dtype=dtype)
    crowd = make_state(1, 1000, 20, dtype=dtype)
    crowd = replace(crowd, sheep=point.expand(1000, 2), shepherds=point.expand(20, 2))
    config = LidarConfig(n_rays=32)
    ranges = scan(crowd, config)
    assert_near(ranges[:, :2], torch.full((20, 2, 32), 0.01), 1e-6)
    on_goal = scan(replace(crowd, goal=point), config)
    assert_near(on_goal[:, 2], torch.full((20, 32), 4.0), 1e-5)
    far = replace(crowd, shepherds=crowd.shepherds + 1e6)
    assert not scan(far, config)[:, [0, 2]].isfinite().any()


# --- noise and dropout --------------------------------------------------------------------------


def surrounded() -> WorldState:
    """Return worlds where a shepherd sees the goal's rim 30 m away all round, another nothing."""
    state = state_of([[500.0, 0.0]], [[0.0, 0.0], [200.0, 0.0]], goal=[0.0, 0.0], goal_radius=30.0)
    states = [replace(state, seed=torch.tensor(seed)) for seed in range(40)]
    return batch(states)


def test_range_noise_is_normal_with_its_standard_deviation_and_leaves_free_rays_free() -> None:
    ranges = scan(surrounded(), LidarConfig(range_noise=0.5))
    error = ranges[:, 0, GOAL] - 30.0  # 20480 draws
    assert error.mean().abs() < 0.02
    assert 0.49 < error.std() < 0.51
    assert 0.66 < (error.abs() < 0.5).double().mean() < 0.70
    assert not ranges[:, :, SHEEP].isfinite().any()
    assert not ranges[:, 1].isfinite().any()


def test_noisy_ranges_stay_between_touching_and_the_greatest_range() -> None:
    ranges = scan(surrounded(), LidarConfig(range_noise=20.0, range_max=31.0))[:, 0, GOAL]
    assert ranges.min() == CONTACT_RANGE
    lost = ranges == NONE
    assert ranges[~lost].max() <= 31.0
    assert 0.44 < lost.double().mean() < 0.52  # beyond 31 m, 1/20 of a deviation: 48 %


def test_a_dropped_ray_returns_nothing_as_often_as_told() -> None:
    for chance in (0.1, 0.5):
        lost = ~scan(surrounded(), LidarConfig(dropout=chance))[:, 0, GOAL].isfinite()
        assert abs(lost.double().mean() - chance) < 0.015
        pairs = (lost[:, 1:] & lost[:, :-1]).double().mean()
        assert abs(pairs - chance**2) < 0.015  # neighbours are independent
    everything = scan(surrounded(), LidarConfig(dropout=1.0))
    assert not everything.isfinite().any()


def test_noise_differs_between_steps_seeds_shepherds_and_channels() -> None:
    config = LidarConfig(n_rays=64, range_noise=0.5)
    ring = torch.tensor([[0.0, 0.0], [0.0, 0.0]])
    state = state_of([[0.0, 0.0]], ring, goal_radius=10.0)  # all in one point
    here = scan(state, config)
    assert torch.equal(here, scan(state, config))
    assert here[:, GOAL].unique().numel() == 2 * 64  # no draw twice
    assert not torch.equal(here[0, SHEEP], here[0, SHEPHERDS])
    for later in (replace(state, step=state.step + 1), replace(state, seed=state.seed + 1)):
        assert not torch.equal(scan(later, config)[0, GOAL], here[0, GOAL])


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('n_rays', 3),
        ('range_max', 0.0),
        ('sheep_radius', 0.0),
        ('shepherd_radius', -1.0),
        ('range_noise', -0.1),
        ('dropout', 1.1),
        ('dropout', math.nan),
    ],
)
def test_a_lidar_that_cannot_be_is_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=name):
        LidarConfig(**{name: value})
