"""
The laws a second time: slow, in float64, one world and one animal at a time.

Written from the formulas of the design document, not from the package, so that the two can be held
against each other. Random draws are inputs of the laws and are taken from the package. Below the
laws are the worlds that the tests share.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shepherd_ros.sim.rng import direction, Stream, uniform
from shepherd_ros.sim.state import stack, WorldState
import torch
from torch import Tensor

Array = NDArray[np.float64]
Point = tuple[float, float]
TINY = 1e-9
torch.set_num_threads(1)  # small tensors: more threads only get in each other's way


@dataclass
class World:
    """One world with nobody absent."""

    seed: int
    step: int
    sheep: Array  # (N, 2)
    heading: Array  # (N, 2)
    shepherds: Array  # (M, 2)
    goal: Array  # (2,)
    goal_radius: float

    @classmethod
    def of(cls, state: WorldState) -> World:
        """Return a single state without those who are absent."""
        return cls(
            int(state.seed),
            int(state.step),
            state.sheep[state.sheep_mask].double().numpy(),
            state.heading[state.sheep_mask].double().numpy(),
            state.shepherds[state.shepherd_mask].double().numpy(),
            state.goal.double().numpy(),
            float(state.goal_radius),
        )

    def draw(self, kind: Any, stream: Stream, count: int) -> Array:
        """Return the draws of this step with index 0, 1, ..."""
        seed, step = torch.tensor(self.seed), torch.tensor(self.step)
        return kind(seed, step, stream, torch.arange(count), torch.float64).numpy()


def length(x: float, y: float) -> float:
    return math.sqrt(x * x + y * y)


def unit(x: float, y: float) -> Point:
    size = length(x, y)
    return (x / size, y / size) if size >= TINY else (0.0, 0.0)


def bearing(x: float, y: float) -> float:
    return math.atan2(y, x)


def wrap(angle: float) -> float:
    while angle >= math.pi:
        angle -= 2 * math.pi
    while angle < -math.pi:
        angle += 2 * math.pi
    return angle


def mean_point(points: Array) -> Point:
    n = len(points)
    return math.fsum(points[:, 0]) / n, math.fsum(points[:, 1]) / n


def away_from(point: Array, others: Array, radius: float) -> tuple[float, float, int]:
    """Return the sum of unit vectors off all others nearer than radius, and how many they are."""
    x, y, count = 0.0, 0.0, 0
    offset = point - others
    distance = np.sqrt(offset[:, 0] ** 2 + offset[:, 1] ** 2)
    for k in np.flatnonzero(distance < radius):
        count += 1
        if distance[k] > 0:
            x += offset[k, 0] / distance[k]
            y += offset[k, 1] / distance[k]
    return x, y, count


# --- flocks -------------------------------------------------------------------------------------


def strombom_flock(world: World, config: Any, dt: float) -> tuple[Array, Array]:
    """Return sheep and heading after dt, section 2.2."""
    sheep, n = world.sheep, len(world.sheep)
    turn = world.draw(direction, Stream.TURN, n)
    chance = world.draw(uniform, Stream.GRAZE, n)
    new_sheep, new_heading = sheep.copy(), world.heading.copy()
    for i in range(n):
        others = np.delete(sheep, i, axis=0)
        sx, sy, noticed = away_from(sheep[i], world.shepherds, config.shepherd_range)
        if not noticed:
            if chance[i] < config.graze_probability:
                new_heading[i] = turn[i]
                new_sheep[i] = sheep[i] + config.speed * dt * turn[i]
            continue
        if config.normalize_shepherds:
            sx, sy = unit(sx, sy)
        ax, ay, _ = away_from(sheep[i], others, config.sheep_range)
        ax, ay = unit(ax, ay)
        cx, cy = 0.0, 0.0
        if n > 1:
            distance = np.hypot(*(others - sheep[i]).T)
            nearest = np.argsort(distance, kind='stable')[: min(config.n_neighbors, n - 1)]
            gx, gy = mean_point(others[nearest])
            cx, cy = gx - sheep[i, 0], gy - sheep[i, 1]
            if not config.metric_attraction:
                cx, cy = unit(cx, cy)
        force = [
            config.inertia * world.heading[i, k]
            + config.cohesion * (cx, cy)[k]
            + config.sheep_repulsion * (ax, ay)[k]
            + config.shepherd_repulsion * (sx, sy)[k]
            + config.noise * turn[i, k]
            for k in range(2)
        ]
        displacement = unit(*force)
        if displacement != (0.0, 0.0):  # forces that cancel: the heading stays
            new_heading[i] = displacement
        new_sheep[i] = sheep[i] + config.speed * dt * new_heading[i]
    return new_sheep, new_heading


def ramp(x: float, y: float) -> Point:
    """Return the direction of a term that is longer than 0.01, a shorter one times 100."""
    size = length(x, y)
    return (x / size, y / size) if size > 0.01 else (x * 100, y * 100)


def reynolds_flock(world: World, config: Any, dt: float) -> tuple[Array, Array]:
    """Return sheep and heading after dt, section 6."""
    sheep, n = world.sheep, len(world.sheep)
    velocity = config.speed * world.heading
    new_sheep, new_heading = sheep.copy(), world.heading.copy()

    def repulsion(i: int, others: Array) -> Point:
        offset = sheep[i] - others
        distance = np.hypot(*offset.T)
        near = distance < config.view_range
        inverse = 1 / np.maximum(distance[near], config.min_distance) ** 2
        return math.fsum(offset[near, 0] * inverse), math.fsum(offset[near, 1] * inverse)

    for i in range(n):
        distance = np.hypot(*(sheep - sheep[i]).T)
        seen = [j for j in np.flatnonzero(distance < config.view_range) if j != i]
        separation = repulsion(i, sheep[seen])
        alignment = cohesion = (0.0, 0.0)
        if seen:
            vx, vy = mean_point(velocity[seen])
            alignment = (vx - velocity[i, 0], vy - velocity[i, 1])
            gx, gy = mean_point(sheep[seen])
            cohesion = (gx - sheep[i, 0], gy - sheep[i, 1])
        fear = repulsion(i, world.shepherds)
        if config.terms == 'unit':
            separation, cohesion, fear = ramp(*separation), ramp(*cohesion), ramp(*fear)
            if seen:
                hx, hy = ramp(*mean_point(world.heading[seen]))
                ahead = ramp(*world.heading[i])
                alignment = (hx - ahead[0], hy - ahead[1])
        force = [
            config.separation * separation[k]
            + config.alignment * alignment[k]
            + config.cohesion * cohesion[k]
            + config.fear * fear[k]
            for k in range(2)
        ]
        size = length(*force)
        cut = min(1.0, config.max_acceleration / size) if size > 0 else 0.0
        displacement = unit(
            velocity[i, 0] + cut * force[0] * dt, velocity[i, 1] + cut * force[1] * dt
        )
        if displacement != (0.0, 0.0):
            new_heading[i] = displacement
        new_sheep[i] = sheep[i] + config.speed * dt * new_heading[i]
    return new_sheep, new_heading


# --- lidar --------------------------------------------------------------------------------------


def disc_ranges(
    origin: Array,
    center: Array,
    radius: float,
    n_rays: int,
    range_max: float,
    *,
    solid: bool,
    margin: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """Return a disc's range on all rays, section 7.1, and which are within margin of a jump."""
    angle = 2 * np.pi * np.arange(n_rays) / n_rays
    wx, wy = center[0] - origin[0], center[1] - origin[1]
    along = wx * np.cos(angle) + wy * np.sin(angle)
    across = np.abs(wy * np.cos(angle) - wx * np.sin(angle))
    distance = length(wx, wy)
    half = np.sqrt(np.maximum(radius**2 - across**2, 0.0))
    if distance > radius:
        hit, ranges = (along > 0) & (across <= radius), along - half
    elif solid:
        hit, ranges = np.ones(n_rays, dtype=bool), np.full(n_rays, 0.01)
    else:
        hit, ranges = np.ones(n_rays, dtype=bool), along + half
    unsure = (
        (np.abs(across - radius) < margin)
        | (hit & (np.abs(ranges - range_max) < margin))
        | (abs(distance - radius) < margin)
    )
    return np.where(hit & (ranges <= range_max), ranges, np.inf), unsure


def lidar(world: World, me: int, config: Any, margin: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return a shepherd's channels (3, n_rays), and which rays are too near a jump to compare."""
    origin = world.shepherds[me]
    ranges = np.full((3, config.n_rays), np.inf)
    unsure = np.zeros((3, config.n_rays), dtype=bool)
    discs = (
        [(0, a, config.sheep_radius, True) for a in world.sheep]
        + [(1, s, config.shepherd_radius, True) for h, s in enumerate(world.shepherds) if h != me]
        + [(2, world.goal, world.goal_radius, False)]
    )
    for channel, center, radius, solid in discs:
        t, doubt = disc_ranges(
            origin, center, radius, config.n_rays, config.range_max, solid=solid, margin=margin
        )
        ranges[channel] = np.minimum(ranges[channel], t)
        unsure[channel] |= doubt
    if config.cross_occlusion:
        body = np.minimum(ranges[0], ranges[1])
        unsure |= unsure[0] | unsure[1]
        unsure |= (
            np.isfinite(body)
            & np.isfinite(ranges)
            & (ranges != body)
            & (
                np.abs(
                    np.where(np.isfinite(ranges), ranges, 0) - np.where(np.isfinite(body), body, 0)
                )
                < margin
            )
        )
        ranges = np.where(ranges > body, np.inf, ranges)
    return ranges, unsure


# --- reward and metrics -------------------------------------------------------------------------


def reward(world: World, config: Any, episode_steps: int) -> dict[str, float]:
    """Return the two terms, section 8.2."""
    n = len(world.sheep)
    inside, outside = 0, []
    for a in world.sheep:
        gap = length(a[0] - world.goal[0], a[1] - world.goal[1]) - world.goal_radius
        if gap <= 0:
            inside += 1
        else:
            outside.append(gap)
    ones = (1 if outside else 0) if config.one_per_step else len(outside)
    return {
        'occupancy': config.occupancy * inside / (n * episode_steps),
        'shaping': config.shaping * (ones + sum(outside)) / (n * episode_steps),
    }


def trajectory_metrics(worlds: list[World], episode_steps: int) -> dict[str, float]:
    """Return all metrics of section 9 from the states of an episode, the first state included."""
    goal, radius = worlds[0].goal, worlds[0].goal_radius
    centers = [mean_point(w.sheep) for w in worlds]
    gaps = [length(x - goal[0], y - goal[1]) for x, y in centers]
    done = next((t for t, gap in enumerate(gaps) if gap <= radius), None)
    last = len(worlds) - 1
    until = last if done is None else done
    n, m = len(worlds[0].sheep), len(worlds[0].shepherds)

    def flock_path(end: int) -> float:
        return sum(math.dist(a, b) for a, b in itertools.pairwise(centers[: end + 1]))

    def team_path(end: int) -> float:
        teams = [w.shepherds for w in worlds[: end + 1]]
        directions = [
            math.dist(a[h], b[h]) for a, b in itertools.pairwise(teams) for h in range(m)
        ]
        return sum(directions) / m

    def variance(t: int, axis: int) -> float:
        return sum((a[axis] - centers[t][axis]) ** 2 for a in worlds[t].sheep) / n

    def spread(t: int) -> float:
        return math.sqrt(variance(t, 0) + variance(t, 1))

    def spread_per_axis(t: int) -> float:
        return (math.sqrt(variance(t, 0)) + math.sqrt(variance(t, 1))) / 2

    def inside(t: int) -> list[bool]:
        return [length(a[0] - goal[0], a[1] - goal[1]) <= radius for a in worlds[t].sheep]

    counted = range(1, last + 1) if last else range(1)  # steps, each by the state that it leads to
    return {
        'completion_time': episode_steps if done is None else done,
        'shepherd_path_length': team_path(last),
        'flock_path_length': flock_path(last),
        'flock_spread': sum(map(spread, counted)) / len(counted),
        'fraction_reached': sum(map(any, zip(*map(inside, range(last + 1)), strict=True))) / n,
        'completed': 0.0 if done is None else 1.0,
        'shepherd_path_to_completion': team_path(until),
        'flock_path_to_completion': flock_path(until),
        'flock_spread_per_axis': sum(map(spread_per_axis, counted)) / len(counted),
        'flock_spread_at_completion': spread(until),
        'fraction_in_goal': sum(inside(last)) / n,
        'goal_distance': gaps[last],
    }


# --- controllers --------------------------------------------------------------------------------


def shortest_shift(slots: list[float], angles: list[float]) -> list[float]:
    """Return the slots in ascending order, cyclically shifted so that the angles are nearest."""
    turned = [slots[k:] + slots[:k] for k in range(len(slots))]
    directions = [
        sum(abs(wrap(s - a)) for s, a in zip(row, angles, strict=True)) for row in turned
    ]
    nearest = [round(1e4 * displacement) for displacement in directions]
    return turned[nearest.index(min(nearest))] if turned else []


def strombom_targets(world: World, config: Any, r: float) -> dict[int, Point]:
    """Return where each shepherd wants to be: the roles of section 4.3."""
    n, m = len(world.sheep), len(world.shepherds)
    gx, gy = mean_point(world.sheep)
    distance = [length(x - gx, y - gy) for x, y in world.sheep]
    behind = bearing(gx - world.goal[0], gy - world.goal[1])
    if config.position_law == 'elfiqi':
        together = r * math.sqrt(2 * n)
        drive, collect = together + config.standoff, config.standoff
    else:
        together = r * n ** (2 / 3)
        drive, collect = r * math.sqrt(n), r

    target: dict[int, Point] = {}
    outliers = [i for i in range(n) if distance[i] > together]
    for i in sorted(outliers, key=lambda i: -distance[i])[:m]:
        free = [h for h in range(m) if h not in target]
        nearest = min((math.dist(world.shepherds[h], world.sheep[i]), h) for h in free)[1]
        x, y = world.sheep[i]
        ox, oy = unit(x - gx, y - gy)
        target[nearest] = (x + collect * ox, y + collect * oy)

    side = sorted(
        (wrap(bearing(x - gx, y - gy) - behind), h)
        for h, (x, y) in enumerate(world.shepherds)
        if h not in target
    )
    spacing = config.wing_spacing or math.pi / (2 * m)
    slots = [(k - (len(side) - 1) / 2) * spacing for k in range(len(side))]
    for slot, (_, h) in zip(
        shortest_shift(slots, [angle for angle, _ in side]), side, strict=True
    ):
        at = behind + slot
        target[h] = (gx + drive * math.cos(at), gy + drive * math.sin(at))
    return target


def detour(place: Point, target: Point, arc: float, stride: float) -> Point:
    """Return the direction of a stride about the flock's center at (0, 0): the arc of 4.3."""
    (x, y), aim = place, bearing(*target)
    phi, d = wrap(aim - bearing(x, y)), length(x, y)
    if d < arc - stride:
        sign, k = (1.0 if phi >= 0 else -1.0), (arc - d) / stride
        ox, oy = unit(x, y)
        return unit(-sign * oy + k * ox, sign * ox + k * oy)
    a = math.acos(max(-1.0, min(1.0, (d * d + stride**2 - arc**2) / (2 * d * stride))))
    choices = []
    for side in (a, -a):
        at = bearing(-x, -y) + side
        displacement = (math.cos(at), math.sin(at))
        left_over = abs(
            wrap(aim - bearing(x + stride * displacement[0], y + stride * displacement[1]))
        )
        choices.append((left_over, displacement))
    return min(choices)[1]


def strombom_controller(
    world: World, config: Any, *, r: float, top: float, dt: float
) -> tuple[Array, Array]:
    """Return commands and targets (M, 2), section 4.3."""
    m = len(world.shepherds)
    gx, gy = mean_point(world.sheep)
    from_center = [length(x - gx, y - gy) for x, y in world.sheep]
    root = math.sqrt(sum(d * d for d in from_center) / len(from_center))
    arc = root if config.arc == 'rms' else max(from_center)
    arc += config.arc_margin or 3 * r
    stop = config.stop_distance or config.stop_range * r
    target = strombom_targets(world, config, r)
    noise = world.draw(direction, Stream.CONTROL, m)
    command = np.zeros((m, 2))
    for h in range(m):
        x, y = world.shepherds[h, 0] - gx, world.shepherds[h, 1] - gy
        tx, ty = target[h][0] - gx, target[h][1] - gy
        ux, uy = unit(tx - x, ty - y)
        speed = min(top, length(tx - x, ty - y) / dt)
        phi = wrap(bearing(tx, ty) - bearing(x, y))
        ahead = length(x + speed * dt * ux, y + speed * dt * uy)
        if abs(phi) > config.arc_tolerance and ahead < arc:
            ux, uy = detour((x, y), (tx, ty), arc, top * dt)
            speed = top
        if config.noise > 0:
            ux, uy = unit(ux + config.noise * noise[h, 0], uy + config.noise * noise[h, 1])
        if min(math.dist(world.shepherds[h], a) for a in world.sheep) < stop:
            speed = 0.0
        command[h] = speed * ux, speed * uy
    return command, np.array([target[h] for h in range(m)])


def arc_share(opening: float, m: int) -> float:
    """Return q(Delta), section 5.3."""
    half = opening / (2 * m - 2)
    return math.sin(m * half) / (m * math.sin(half)) if abs(half) > 1e-12 else 1.0


def arc_opening(share: float, m: int) -> float:
    """Return the Delta in [0, 2 pi (m - 1) / m] with q(Delta) = share, by bisection."""
    low, high = 0.0, 2 * math.pi * (m - 1) / m
    for _ in range(200):
        middle = (low + high) / 2
        if arc_share(middle, m) > share:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def pierson_controller(
    world: World,
    phi: float,
    config: Any,
    *,
    notice_range: float,
    sheep_speed: float,
    top: float,
    dt: float,
) -> tuple[Array, float]:
    """Return commands (M, 2) and the next phi, section 5.3."""
    m = len(world.shepherds)
    gx, gy = mean_point(world.sheep)
    c, s = math.cos(phi), math.sin(phi)
    px = gx + config.lead * c - world.goal[0]
    py = gy + config.lead * s - world.goal[1]
    forward = -config.gain * (px * c + py * s)
    turn = -config.gain / config.lead * (-px * s + py * c)
    phi = phi + max(-config.max_turn_rate, min(config.max_turn_rate, turn)) * dt
    share = max(config.weakest_push, min(config.strongest_push, forward / sheep_speed))
    spread = math.sqrt(
        sum((a[0] - gx) ** 2 + (a[1] - gy) ** 2 for a in world.sheep) / len(world.sheep)
    )
    longest = config.max_radius or 0.75 * notice_range
    radius = min(max(config.spread_factor * spread, config.min_radius), longest)
    gain = config.tracking_gain or min(1 / dt, 2.0)
    order = list(range(m))
    if m == 1:
        at = bearing(world.goal[0] - gx, world.goal[1] - gy) + math.pi
        places = [(gx + radius * math.cos(at), gy + radius * math.sin(at))]
    else:
        opening = arc_opening(share, m)
        slots = [opening * (2 * j - m - 1) / (2 * m - 2) for j in range(1, m + 1)]
        if config.assignment == 'sorted':
            around = [wrap(bearing(x - gx, y - gy) - phi - math.pi) for x, y in world.shepherds]
            order.sort(key=lambda h: around[h])
            slots = shortest_shift(slots, [around[h] for h in order])
        places = []
        for slot in slots:
            at = phi + math.pi + slot
            places.append((gx + radius * math.cos(at), gy + radius * math.sin(at)))
    command = np.zeros((m, 2))
    for place, h in zip(places, order, strict=True):
        vx = gain * (place[0] - world.shepherds[h, 0])
        vy = gain * (place[1] - world.shepherds[h, 1])
        speed = length(vx, vy)
        cut = top / speed if speed > top or config.pace == 'constant' else 1.0
        command[h] = vx * cut, vy * cut
    return command, phi


# --- random numbers -----------------------------------------------------------------------------


def around_circle(angles: list[float]) -> list[tuple[float, float]]:
    """Return bearings in [0, 2 pi) in order, each with the gap to the next one."""
    turn = 2 * math.pi
    row = sorted(angle % turn for angle in angles)
    return [(a, b - a) for a, b in zip(row, [*row[1:], row[0] + turn], strict=True)]


def between_neighbors(angles: list[float]) -> list[float]:
    """Return for each bearing the middle between the next ones on both sides."""
    turn, middles = 2 * math.pi, []
    for h, angle in enumerate(angles):
        others = [(other - angle) % turn for k, other in enumerate(angles) if k != h]
        left, right = min(others, default=turn), min((turn - o for o in others), default=turn)
        middles.append(angle + (left - right) / 2)
    return middles


def drover_circle(world: World, config: Any, *, restless: bool, notice: float, top: float) -> Any:
    """Return middle, radius, bearing, spacing, whether along it, pace and whether evenly."""
    n, m, size = len(world.sheep), len(world.shepherds), world.goal_radius
    (gx, gy), center = world.goal, mean_point(world.sheep)
    behind = bearing(center[0] - gx, center[1] - gy)
    away = math.dist(center, world.goal)
    edge = math.sqrt(2 * math.fsum(math.dist(s, center) ** 2 for s in world.sheep) / n)
    inside = sum(math.dist(s, world.goal) <= size for s in world.sheep) / n
    bearings = [bearing(x - gx, y - gy) for x, y in world.shepherds]
    row = around_circle(bearings)
    reach, least = (-0.15, 3) if restless else (0.45, 2)
    ring = notice + (config.ring_reach or reach) * size
    slow = 1.0 if restless else config.ring_speed

    if restless and m < least and away < config.touch_distance * size:
        hx, hy = mean_point(world.heading)
        left = math.sin(bearing(hx, hy) - behind) >= 0
        crossing = max(0.0, 1 - away / (0.75 * size)) * config.touch_angle
        at = behind - crossing if left else behind + crossing
        radius = edge + notice - config.touch_depth
        return center, radius, at, config.touch_spacing, True, top, False

    if m < least:
        arc = 1.0
    elif restless:
        closed = max(gap for _, gap in row) < 4.0
        arc = float(inside < (config.reopen_share if closed else config.close_share))
    else:
        arc = (away / size - config.open_until) / (config.open_from - config.open_until)
        arc = min(max(arc, 0.0), 1.0)
    part = 2 * math.pi / m
    widest = max(range(m), key=lambda k: (row[k][1], -k))
    middle = sum(a + 2 * math.pi * (k <= widest) for k, (a, _) in enumerate(row)) / m
    turn = (middle - behind + part / 2) % part - part / 2
    radius = arc * max(away + edge + config.standoff, notice) + (1 - arc) * ring
    spacing = arc * config.spacing + (1 - arc) * part
    at, pace = behind + (1 - arc) * turn, top * slow  # along the circle only

    if not restless and m < least and inside >= config.lone_share:
        circle = notice + config.lone_reach * size
        return world.goal, circle, bearings[0] + 1.0, spacing, True, config.lone_speed * top, False
    return world.goal, radius, at, spacing, arc < 1, pace, arc == 0


def drover_detour(place: Point, target: Point, center: Point, clear: float) -> Point:
    """Return the displacement toward a target, or along the flock where that is in between."""
    (x, y), (tx, ty) = np.subtract(place, center), np.subtract(target, center)
    d, turn = length(x, y), wrap(bearing(tx, ty) - bearing(x, y))
    sx, sy = tx - x, ty - y
    along = min(max(-(x * sx + y * sy) / max(length(sx, sy), 1e-6) ** 2, 0.0), 1.0)
    nearest = length(x + along * sx, y + along * sy)
    if not (nearest < min(clear, d) - 0.01 and abs(turn) > 0.2):
        return sx, sy
    at = bearing(x, y) + math.copysign(math.pi / 2, turn)
    out = min(max(clear - d, 0.0), 1.0)
    (ox, oy) = unit(x, y)
    return 10 * (math.cos(at) + out * ox), 10 * (math.sin(at) + out * oy)


def clipped(x: float, y: float, most: float) -> Point:
    """Return a vector at most so long."""
    size = length(x, y)
    return (x * most / size, y * most / size) if size > most else (x, y)


def drover_controller(
    world: World, config: Any, *, restless: bool, notice: float, top: float
) -> Array:
    """Return the drover's commands (M, 2)."""
    notice = config.notice_range or notice
    middle, radius, at, spacing, along, pace, even = drover_circle(
        world, config, restless=restless, notice=notice, top=top
    )
    m, center = len(world.shepherds), mean_point(world.sheep)
    edge = math.sqrt(2 * sum(math.dist(s, center) ** 2 for s in world.sheep) / len(world.sheep))
    own = [bearing(x - middle[0], y - middle[1]) for x, y in world.shepherds]
    order = sorted(range(m), key=lambda h: (wrap(own[h] - at), h))
    slots = shortest_shift(
        [(k - (m - 1) / 2) * spacing for k in range(m)], [wrap(own[h] - at) for h in order]
    )
    place = dict(zip(order, [at + slot for slot in slots], strict=True))
    if even:
        place = dict(enumerate(between_neighbors(own)))
    commands = np.zeros((m, 2))
    for h, (x, y) in enumerate(world.shepherds):
        if along:
            d, step = math.dist((x, y), middle), pace / config.gain
            new = d + min(max(radius - d, -step), step)
            turn = min(max(wrap(place[h] - own[h]), -step / radius), step / radius)
            bend = own[h] + (turn if new >= radius - min(radius / 2, 0.5) else 0.0)
            displacement = (
                middle[0] + new * math.cos(bend) - x,
                middle[1] + new * math.sin(bend) - y,
            )
        else:
            target = (
                middle[0] + radius * math.cos(place[h]), middle[1] + radius * math.sin(place[h])
            )  # fmt: skip
            displacement = drover_detour((x, y), target, center, edge + config.standoff)
        px = py = 0.0
        for k, other in enumerate(world.shepherds):
            if k != h and config.separation:
                near = max(0.0, 1 - math.dist((x, y), other) / config.separation)
                ux, uy = unit(x - other[0], y - other[1])
                # 45 degrees to the left of straight away: both turn alike
                px += 2 * near * (ux - uy) / math.sqrt(2)
                py += 2 * near * (ux + uy) / math.sqrt(2)
        vx, vy = clipped(displacement[0] * config.gain, displacement[1] * config.gain, top)
        commands[h] = clipped(vx + px * top, vy + py * top, top)
    return commands


def splitmix_bits(seed: int, step: int, stream: int, index: int) -> int:
    """Return the 64 bits of a draw as a signed integer, with Python's unbounded integers."""
    mask, golden = (1 << 64) - 1, 0x9E3779B97F4A7C15

    def mix(z: int) -> int:
        z &= mask
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        return z ^ (z >> 31)

    key = mix(mix(seed + golden) + step * golden + stream)
    bits = mix(key + (index + 1) * golden)
    return bits - (1 << 64) if bits >> 63 else bits


# --- worlds for the tests -----------------------------------------------------------------------


def make_state(
    seed: int,
    n: int,
    m: int,
    *,
    spread: float = 4.0,
    reach: float = 25.0,
    goal_radius: float = 4.0,
    dtype: torch.dtype = torch.float64,
) -> WorldState:
    """
    Return a random world: n sheep around a random center, m shepherds within reach of it.

    Numbers are rounded to float32, so that the same world is had in both precisions.
    """
    rng = np.random.default_rng(seed)

    def tensor(value: Any) -> Tensor:
        return torch.tensor(np.asarray(value, dtype=np.float32)).to(dtype)

    center = rng.uniform(-20, 20, 2)
    angle = rng.uniform(0, 2 * np.pi, n)
    turn, away = rng.uniform(0, 2 * np.pi, m), reach * np.sqrt(rng.uniform(0, 1, m))
    return WorldState(
        seed=torch.tensor(int(rng.integers(-(2**62), 2**62))),
        step=torch.tensor(int(rng.integers(0, 1000))),
        sheep=tensor(center + spread * rng.normal(size=(n, 2))),
        heading=tensor(np.stack([np.cos(angle), np.sin(angle)], -1)),
        sheep_mask=torch.ones(n, dtype=torch.bool),
        shepherds=tensor(center + np.stack([away * np.cos(turn), away * np.sin(turn)], -1)),
        shepherd_mask=torch.ones(m, dtype=torch.bool),
        goal=tensor(rng.uniform(-5, 5, 2)),
        goal_radius=tensor(goal_radius),
    )


def state_of(
    sheep: Any,
    shepherds: Any,
    *,
    heading: Any = None,
    goal: Any = (0.0, 0.0),
    goal_radius: float = 4.0,
    seed: int = 0,
    step: int = 0,
    dtype: torch.dtype = torch.float64,
) -> WorldState:
    """Return a world made by hand; all sheep head along +x unless told."""
    sheep = torch.as_tensor(sheep, dtype=dtype).reshape(-1, 2)
    shepherds = torch.as_tensor(shepherds, dtype=dtype).reshape(-1, 2)
    if heading is None:
        heading = torch.tensor([1.0, 0.0]).expand(len(sheep), 2)
    return WorldState(
        seed=torch.tensor(seed),
        step=torch.tensor(step),
        sheep=sheep,
        heading=torch.as_tensor(heading, dtype=dtype).reshape(-1, 2).clone(),
        sheep_mask=torch.ones(len(sheep), dtype=torch.bool),
        shepherds=shepherds,
        shepherd_mask=torch.ones(len(shepherds), dtype=torch.bool),
        goal=torch.as_tensor(goal, dtype=dtype),
        goal_radius=torch.tensor(goal_radius, dtype=dtype),
    )


def padded(state: WorldState, sheep: int = 0, shepherds: int = 0) -> WorldState:
    """Return a single world with absent ones after the present, on the goal."""

    def add(points: Tensor, count: int, value: Tensor) -> Tensor:
        return torch.cat([points, value.expand(count, *points.shape[1:])])

    absent = torch.tensor(False)
    ahead = torch.tensor([1.0, 0.0], dtype=state.heading.dtype)
    return replace(
        state,
        sheep=add(state.sheep, sheep, state.goal),
        heading=add(state.heading, sheep, ahead),
        sheep_mask=add(state.sheep_mask, sheep, absent),
        shepherds=add(state.shepherds, shepherds, state.goal),
        shepherd_mask=add(state.shepherd_mask, shepherds, absent),
    )


def batch(states: list[WorldState]) -> WorldState:
    """Return single worlds of any sizes as one batch."""
    n = max(s.sheep.shape[0] for s in states)
    m = max(s.shepherds.shape[0] for s in states)
    return stack([padded(s, n - s.sheep.shape[0], m - s.shepherds.shape[0]) for s in states])


def moved(state: WorldState, angle: float, shift: Any = (0.0, 0.0)) -> WorldState:
    """Return the world turned about the origin and then shifted."""
    c, s = math.cos(angle), math.sin(angle)
    by = torch.as_tensor(shift, dtype=state.sheep.dtype)
    return replace(
        state,
        sheep=turned(state.sheep, c, s) + by,
        heading=turned(state.heading, c, s),
        shepherds=turned(state.shepherds, c, s) + by,
        goal=turned(state.goal, c, s) + by,
    )


def turned(vector: Tensor, c: float, s: float) -> Tensor:
    """Return vectors turned by the angle with this cosine and sine."""
    return torch.stack(
        [c * vector[..., 0] - s * vector[..., 1], s * vector[..., 0] + c * vector[..., 1]], dim=-1
    )


def assert_near(result: Tensor, expected: Any, tolerance: float) -> None:
    """Fail unless equal within an absolute tolerance; infinities have to be in the same places."""
    result = torch.as_tensor(result)
    expected = torch.as_tensor(expected, dtype=result.dtype)
    torch.testing.assert_close(result, expected, rtol=0.0, atol=tolerance)


def assert_same_world(a: WorldState, b: WorldState) -> None:
    """Fail unless two states are equal to the last bit."""
    for f in fields(a):
        left, right = getattr(a, f.name), getattr(b, f.name)
        assert torch.equal(left, right), f'{f.name} differs by {(left - right).abs().max()}'
