"""
Grid of cells over a large flock, for neighbors without a look at every sheep.

Sheep outside the grid count to its outermost cells, which can only make them look nearer than they
are; so bounds on distances hold for them, too.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import math

import numpy as np
from shepherd_ros.sim.compiled import compiled
from shepherd_ros.sim.neighbors_compiled import squared_distances_of

SHEEP_PER_CELL = 16.0  # sheep in the cell of a sheep that are aimed at
GRID_REACH = np.float32(2.5)  # standard deviations of the flock that the grid reaches to each side
MAX_CELLS_PER_SHEEP = 4  # cells at most, in numbers of sheep
_MIN_REDUCTION = 3  # the grid is used where at most one cell in so many is looked at
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
    """Sort the present sheep into cells; return the mean number in the cell of a sheep."""
    n = sheep.shape[0]
    start[: nx * ny + 1] = 0
    for i in range(n):
        column = _cell(sheep[i, 0], low_x, side, nx)
        cell[i] = _cell(sheep[i, 1], low_y, side, ny) * nx + column
        if mask[i]:
            start[cell[i] + 1] += 1
    total, occupancy = 0, 0.0
    for c in range(nx * ny):
        occupancy += float(start[c + 1]) * start[c + 1]
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
    return occupancy / max(total, 1)


@compiled
def build_grid(sheep, mask):
    """
    Return a grid over the present ones of sheep (N, 2) m.

    It is side [m], columns, rows, the cell of each sheep (N,), the index in members where each
    cell begins, and members, the sheep cell by cell.
    """
    n = sheep.shape[0]
    count, mean_x, mean_y = 0, 0.0, 0.0
    for i in range(n):
        if mask[i]:
            count += 1
            mean_x += sheep[i, 0]
            mean_y += sheep[i, 1]
    mean_x, mean_y = mean_x / max(count, 1), mean_y / max(count, 1)
    squares_x, squares_y = 0.0, 0.0
    for i in range(n):
        if mask[i]:
            squares_x += (sheep[i, 0] - mean_x) ** 2
            squares_y += (sheep[i, 1] - mean_y) ** 2
    reach_x = GRID_REACH * math.sqrt(squares_x / max(count, 1)) + 1e-3
    reach_y = GRID_REACH * math.sqrt(squares_y / max(count, 1)) + 1e-3
    cell = np.zeros(n, np.int64)
    members = np.zeros(n, np.int64)
    start = np.zeros(MAX_CELLS_PER_SHEEP * n + 2, np.int64)
    side = math.sqrt(4 * reach_x * reach_y * SHEEP_PER_CELL / max(count, 1))
    low_x, low_y = np.float32(mean_x - reach_x), np.float32(mean_y - reach_y)
    nx, ny, best_side = 1, 1, side
    for _ in range(CROWDED_REFINEMENT):
        columns = max(int(2 * reach_x / side), 1)
        rows = max(int(2 * reach_y / side), 1)
        if columns * rows > MAX_CELLS_PER_SHEEP * n:
            break
        nx, ny, best_side = columns, rows, side
        occupancy = _fill(
            sheep, mask, low_x, low_y, np.float32(side), nx, ny, cell, start, members
        )
        if occupancy <= 2 * SHEEP_PER_CELL:
            break
        side /= 2
    if nx * ny == 1:
        best_side = side
        _fill(sheep, mask, low_x, low_y, np.float32(side), 1, 1, cell, start, members)
    return np.float32(best_side), nx, ny, cell, start, members


@compiled
def empty_grid():
    """Return an empty grid."""
    empty = np.zeros(1, np.int64)
    return np.float32(1), 0, 0, empty, empty, empty


@compiled
def reduces_candidates(reach, grid):
    """Return whether candidates_within() leaves out most of the flock."""
    side, nx, ny = grid[0], grid[1], grid[2]
    cells = 2 * int(reach / side) + 3
    return _MIN_REDUCTION * cells * cells <= nx * ny


@compiled
def ring(i, distance, grid, count, candidates):
    """
    Add the sheep in the cells exactly `distance` cells from that of sheep i to candidates.

    Return the number of candidates, and whether the ring lies outside the grid.
    """
    _, nx, ny, cell, start, members = grid
    column, row = cell[i] % nx, cell[i] // nx
    inside = False
    for y in range(row - distance, row + distance + 1):
        if y < 0 or y >= ny:
            continue
        edge = y == row - distance or y == row + distance
        x = column - distance
        while x <= column + distance:
            if 0 <= x < nx:
                inside = True
                c = y * nx + x
                for k in range(start[c], start[c + 1]):
                    candidates[count] = members[k]
                    count += 1
            x += 1 if edge or distance == 0 else 2 * distance
    return count, not inside


@compiled
def candidates_within(i, reach, grid, candidates):
    """Write all sheep nearer to sheep i than reach [m], and others; return their number."""
    count, distance = 0, 0
    while True:
        count, ended = ring(i, distance, grid, count, candidates)
        if ended or distance * grid[0] >= reach:
            return count
        distance += 1


@compiled
def nearest_candidates(i, xs, ys, keep, grid, candidates, squared):
    """
    Write candidates, among them the `keep` nearest to sheep i; return their number.

    Their squared distances [m^2] are written into squared.
    """
    counted, count, distance = 0, 0, 0
    while True:
        count, ended = ring(i, distance, grid, count, candidates)
        squared_distances_of(i, xs, ys, candidates[counted:], count - counted, squared[counted:])
        counted = count
        if ended:
            return count
        if count > keep:  # nobody in a farther ring is nearer than the rings reach
            certain = 0
            limit = (distance * grid[0]) ** 2
            for k in range(count):
                certain += squared[k] <= limit
            if certain >= keep:
                return count
        distance += 1
