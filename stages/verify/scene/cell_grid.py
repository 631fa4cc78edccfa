"""The scene's points in square cells, as kernels walk over them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F64, I64
from spinpipe.schemas.records import Sampling
from spinpipe.stages.compiled import inner
from spinpipe.stages.geometry.columns import column_order


class CellGrid(NamedTuple):
    """Points sorted by the cell of a square grid over x and y; cell (i, j) is i * columns + j.

    Attributes
    ----------
    points : (N, 3) float64, metres, in the world or in the frame of a support.
    weights : (N,) float64, 1 / number of points in the same voxel: equal surface, equal weight.
    start : (rows * columns + 1,) int64, first point of each cell.
    corner : (2,) float64, least x and y.
    cell_m : side of a cell.
    density : points per square metre of the whole cloud.
    """

    points: F64
    weights: F64
    start: I64
    rows: int
    columns: int
    corner: F64
    cell_m: float
    density: float


def grid_of(points: NDArray[np.floating], sampling: Sampling) -> CellGrid:
    """Order points for look-up.

    The grid is anchored at the origin, so a part of a cloud is ordered as the whole is.

    Parameters
    ----------
    points : (N, 3), metres; at least one.
    sampling : of the whole cloud.
    """
    xyz = np.asarray(points, dtype=np.float64)
    cell_m = 2.0 * sampling.spacing_m
    order, first, keys, low, cells = column_order(xyz, cell_m)
    xyz = xyz[order]
    column = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(xyz))))
    start = np.searchsorted(keys[column], np.arange(cells[0] * cells[1] + 1))
    level = np.floor(xyz[:, 2] / cell_m).astype(np.int64)
    # points are sorted by height within their column: a voxel is one run
    fresh = np.r_[True, (np.diff(level) != 0) | (np.diff(column) != 0)]
    run = np.cumsum(fresh) - 1
    return CellGrid(
        points=xyz,
        weights=1.0 / np.bincount(run)[run],
        start=start.astype(np.int64),
        rows=int(cells[0]),
        columns=int(cells[1]),
        corner=np.asarray(low, dtype=np.float64) * cell_m,
        cell_m=cell_m,
        density=float(sampling.density),
    )


class Window(NamedTuple):
    """Cells that a square around a place touches: rows and columns from the first to past the last.

    Empty beside the grid.
    """

    first: int
    past: int
    low: int
    high: int


@inner
def _span(centre, reach, corner, pitch, cells):
    """First cell that a span touches along one axis and the one past its last.

    Equal where the span lies beside the grid: indices past its end would read foreign memory.
    """
    low = int(math.floor((centre - reach - corner) / pitch))
    high = int(math.floor((centre + reach - corner) / pitch)) + 1
    return min(max(low, 0), cells), min(max(high, 0), cells)


@inner
def window(grid, x, y, reach):
    """Cells within ``reach`` of a place along both axes."""
    first, past = _span(x, reach, grid.corner[0], grid.cell_m, grid.rows)
    low, high = _span(y, reach, grid.corner[1], grid.cell_m, grid.columns)
    return Window(first, past, low, high)


@inner
def points_of(grid, cells, i):
    """Points of the window's cells in grid row i: they are one run."""
    row = i * grid.columns
    return range(grid.start[row + cells.low], grid.start[row + cells.high])


@inner
def within(grid, x, y, radius):
    """Rows of the points within a horizontal distance of a place."""
    cells = window(grid, x, y, radius)
    total = 0
    for i in range(cells.first, cells.past):
        total += len(points_of(grid, cells, i))
    rows = np.empty(total, np.int64)
    count = 0
    for i in range(cells.first, cells.past):
        for n in points_of(grid, cells, i):
            dx, dy = grid.points[n, 0] - x, grid.points[n, 1] - y
            if dx * dx + dy * dy < radius * radius:
                rows[count] = n
                count += 1
    return rows[:count]


@inner
def seen_from(grid, origin, axes, radius):
    """The points around a place in a frame of its own, in cells again.

    Parameters
    ----------
    grid : CellGrid, world.
    origin : (3,) the frame's origin, world.
    axes : (3, 3) its axes as columns, world.
    radius : how far points are wanted, metres.

    Returns
    -------
    CellGrid
        In the new frame; cells are anchored at its origin.
    """
    rows = within(grid, origin[0], origin[1], radius)
    half = int(math.ceil(radius / grid.cell_m)) + 1
    side = 2 * half
    cell = np.empty(rows.shape[0], np.int64)
    turned = np.empty((rows.shape[0], 3))
    start = np.zeros(side * side + 1, np.int64)
    for n in range(rows.shape[0]):
        p = grid.points[rows[n]]
        dx, dy, dz = p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]
        for k in range(3):
            turned[n, k] = axes[0, k] * dx + axes[1, k] * dy + axes[2, k] * dz
        i = int(math.floor(turned[n, 0] / grid.cell_m)) + half
        j = int(math.floor(turned[n, 1] / grid.cell_m)) + half
        inside = 0 <= i < side and 0 <= j < side
        cell[n] = i * side + j if inside else -1
        if inside:
            start[cell[n] + 1] += 1
    for k in range(side * side):
        start[k + 1] += start[k]
    points, weights = np.empty((start[-1], 3)), np.empty(start[-1])
    place = start[:-1].copy()
    for n in range(rows.shape[0]):
        if cell[n] >= 0:
            at = place[cell[n]]
            place[cell[n]] += 1
            points[at] = turned[n]
            weights[at] = grid.weights[rows[n]]
    corner = np.full(2, -half * grid.cell_m)
    return CellGrid(points, weights, start, side, side, corner, grid.cell_m, grid.density)
