"""The scene's points in square cells, as kernels walk over them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.compiled import inner


class CellGrid(NamedTuple):
    """World points sorted by cell, see ``Surroundings``; cell (i, j) is number i * columns + j."""

    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    heights: NDArray[np.float64]
    start: NDArray[np.int64]
    rows: int
    columns: int
    corner: NDArray[np.float64]
    cell_m: float
    density: float
    """Points per square metre."""


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
