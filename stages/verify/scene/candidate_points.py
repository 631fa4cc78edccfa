"""The points around a candidate: those of a body that may stand there, and those of the ground."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.scene.cell_grid import points_of, window

TOO_FEW = 10
"""Fewer points are no body."""
GROUND_POINTS = 400


class Points(NamedTuple):
    """(N, 3) world points and (N,) how much surface each stands for."""

    xyz: NDArray[np.float64]
    weights: NDArray[np.float64]


@inner
def cut_out(grid, x, y, radius, low, ceiling, count):
    """Points within a horizontal distance: about ``count`` of bodies, some of the ground.

    Parameters
    ----------
    grid : CellGrid.
    radius : metres.
    low : what is no higher than this above the local ground is ground, metres.
    ceiling : height above which nothing belongs to a body, world.
    count : how many points of bodies are enough.

    Returns
    -------
    body, ground : Points.
    """
    rows = _within(grid, x, y, radius)
    body, ground = _split(grid, rows, low, ceiling)
    return _thin(grid, body, count), _thin(grid, ground, GROUND_POINTS)


@inner
def _within(grid, x, y, radius):
    """Rows of the points within a horizontal distance."""
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
def _split(grid, rows, low, ceiling):
    """Rows that may belong to an object, and rows of the ground."""
    body = np.empty(rows.shape[0], np.int64)
    ground = np.empty(rows.shape[0], np.int64)
    bodies = 0
    grounds = 0
    for row in rows:
        if grid.heights[row] <= low:
            ground[grounds] = row
            grounds += 1
        elif grid.points[row, 2] < ceiling:
            body[bodies] = row
            bodies += 1
    return body[:bodies], ground[:grounds]


@inner
def _thin(grid, rows, count):
    """About ``count`` of the rows, evenly strided, with weights that keep their sum."""
    stride = max(1, (rows.shape[0] + count - 1) // count)
    n = (rows.shape[0] + stride - 1) // stride
    chosen = np.empty((n, 3))
    weight = np.empty(n)
    for k in range(n):
        chosen[k] = grid.points[rows[k * stride]]
        weight[k] = grid.weights[rows[k * stride]] * stride
    return Points(chosen, weight)
