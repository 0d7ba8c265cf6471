"""
A grid over a large flock: who is near is found without looking at everybody.

Sheep outside the grid count to its outermost cells, which can only make them look nearer than they
are; so bounds on distances hold for them, too.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from shepherd_ros.sim.compiled import compiled
from shepherd_ros.sim.neighbors_compiled import squares_of

SHEEP_PER_CELL = 16.0  # sheep in the cell of a sheep that are aimed at
GRID_REACH = np.float32(2.5)  # standard deviations of the flock that the grid reaches to each side
MAX_CELLS_PER_SHEEP = 4  # cells at most, in numbers of sheep
_SHARE = 3  # of the flock that is left out at least: all but one in so many
CROWDED_REFINEMENT = 6  # times that cells are made smaller where sheep crowd in few of them


@compiled
def _cell(value, low, side, count):
    """Return the index of a coordinate along one axis, that of the outermost cell beyond."""
    place = (value - low) / side
    if not place > 0:
        return 0
    return count - 1 if place >= count else int(place)


@compiled
def _fill(sheep, mask, low_x, low_y, side, nx, ny, cell, start, members):
    """Sort the present into cells; return how many are in the cell of a sheep, on average."""
    n = sheep.shape[0]
    start[: nx * ny + 1] = 0
    for i in range(n):
        column = _cell(sheep[i, 0], low_x, side, nx)
        cell[i] = _cell(sheep[i, 1], low_y, side, ny) * nx + column
        if mask[i]:
            start[cell[i] + 1] += 1
    total, crowd = 0, 0.0
    for c in range(nx * ny):
        crowd += float(start[c + 1]) * start[c + 1]
        start[c + 1] += start[c]
        total = start[c + 1]
    for i in range(n - 1, -1, -1):
        if mask[i]:
            start[cell[i] + 1] -= 1
            members[start[cell[i] + 1]] = i
    # start[c + 1] is now where cell c begins
    for c in range(nx * ny):
        start[c] = start[c + 1]
    start[nx * ny] = total
    return crowd / max(total, 1)


@compiled
def build(sheep, mask):
    """
    Return a grid over the present of sheep (N, 2) m.

    It is side [m], columns, rows, the cell of each sheep (N,), where each cell begins in members,
    and members, the sheep cell by cell.
    """
    n = sheep.shape[0]
    count, mean_x, mean_y = 0, 0.0, 0.0
    for i in range(n):
        if mask[i]:
            count += 1
            mean_x += sheep[i, 0]
            mean_y += sheep[i, 1]
    mean_x, mean_y = mean_x / max(count, 1), mean_y / max(count, 1)
    wide_x, wide_y = 0.0, 0.0
    for i in range(n):
        if mask[i]:
            wide_x += (sheep[i, 0] - mean_x) ** 2
            wide_y += (sheep[i, 1] - mean_y) ** 2
    reach_x = GRID_REACH * math.sqrt(wide_x / max(count, 1)) + 1e-3
    reach_y = GRID_REACH * math.sqrt(wide_y / max(count, 1)) + 1e-3
    cell = np.zeros(n, np.int64)
    members = np.zeros(n, np.int64)
    start = np.zeros(MAX_CELLS_PER_SHEEP * n + 2, np.int64)
    side = math.sqrt(4 * reach_x * reach_y * SHEEP_PER_CELL / max(count, 1))
    low_x, low_y = np.float32(mean_x - reach_x), np.float32(mean_y - reach_y)
    nx, ny, kept = 1, 1, side
    for _ in range(CROWDED_REFINEMENT):
        columns = max(int(2 * reach_x / side), 1)
        rows = max(int(2 * reach_y / side), 1)
        if columns * rows > MAX_CELLS_PER_SHEEP * n:
            break
        nx, ny, kept = columns, rows, side
        crowd = _fill(sheep, mask, low_x, low_y, np.float32(side), nx, ny, cell, start, members)
        if crowd <= 2 * SHEEP_PER_CELL:
            break
        side /= 2
    if nx * ny == 1:
        kept = side
        _fill(sheep, mask, low_x, low_y, np.float32(side), 1, 1, cell, start, members)
    return np.float32(kept), nx, ny, cell, start, members


@compiled
def nothing():
    """Return an empty grid."""
    few = np.zeros(1, np.int64)
    return np.float32(1), 0, 0, few, few, few


@compiled
def leaves_out(reach, grid):
    """Return whether within() leaves out most of the flock, so that it pays."""
    side, nx, ny = grid[0], grid[1], grid[2]
    cells = 2 * int(reach / side) + 3
    return _SHARE * cells * cells <= nx * ny


@compiled
def ring(i, far, grid, found, candidates):
    """
    Add the sheep in the cells exactly `far` cells from that of sheep i to candidates.

    Return how many candidates there are then, and whether the grid ends within the ring.
    """
    _, nx, ny, cell, start, members = grid
    column, row = cell[i] % nx, cell[i] // nx
    inside = False
    for y in range(row - far, row + far + 1):
        if y < 0 or y >= ny:
            continue
        edge = y == row - far or y == row + far
        x = column - far
        while x <= column + far:
            if 0 <= x < nx:
                inside = True
                c = y * nx + x
                for k in range(start[c], start[c + 1]):
                    candidates[found] = members[k]
                    found += 1
            x += 1 if edge or far == 0 else 2 * far
    return found, not inside


@compiled
def within(i, reach, grid, who):
    """Write all sheep nearer to sheep i than reach [m], and others, into who; return how many."""
    found, rings = 0, 0
    while True:
        found, ended = ring(i, rings, grid, found, who)
        if ended or rings * grid[0] >= reach:
            return found
        rings += 1


@compiled
def around(i, xs, ys, keep, grid, who, squared):
    """
    Write sheep among which are the keep nearest to sheep i into who; return how many.

    Their squared distances [m^2] come into squared.
    """
    done, found, rings = 0, 0, 0
    while True:
        found, ended = ring(i, rings, grid, found, who)
        squares_of(i, xs, ys, who[done:], found - done, squared[done:])
        done = found
        if ended:
            return found
        if found > keep:  # nobody in a farther ring is nearer than the rings reach
            sure = 0
            limit = (rings * grid[0]) ** 2
            for k in range(found):
                sure += squared[k] <= limit
            if sure >= keep:
                return found
        rings += 1
