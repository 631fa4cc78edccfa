"""Local ground: the height of the ground in every cell of a grid, whatever stands on it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, grey_opening

from spinpipe.schemas.arrays import F64, I64, Mask

GRADE = 0.05
"""By how much ground may slope to either side of a crest: roads are crowned by 2 to 4 %."""


@dataclass(frozen=True)
class GroundGrid:
    """Ground heights over a rectangle of the world's x-y plane."""

    low: F64
    """(2,) least x and y, metres."""
    cell_m: float
    height: F64
    """(X, Y) world z of the ground; where none was seen that of the nearest cell with ground."""
    seen: Mask
    """(X, Y) whether ground was seen in the cell."""

    def cells(self, xy: NDArray[np.floating]) -> tuple[I64, Mask]:
        """Cells (N, 2) of points (N, 2), clipped to the grid, and which lie on it (N,)."""
        cells = np.floor((xy - self.low) / self.cell_m).astype(np.int64)
        last = np.array(self.height.shape) - 1
        inside = np.all((cells >= 0) & (cells <= last), axis=1)
        return np.clip(cells, 0, last), inside

    def heights(self, xy: NDArray[np.floating]) -> F64:
        """Ground height (N,) at points (N, 2); beyond the grid that of its border."""
        cells, _ = self.cells(xy)
        return self.height[cells[:, 0], cells[:, 1]]


def ground_grid(
    pieces: Iterable[NDArray[np.floating]],
    low: F64,
    high: F64,
    *,
    cell_m: float,
    window_m: float,
    step_m: float,
) -> GroundGrid:
    """Ground from the lowest point of each cell, by progressive morphological opening.

    The window grows, and with it what may stand out: ground that is crowned or changes its slope
    stands out of a wide window, things already of a narrow one [Zhang et al. 2003, A progressive
    morphological filter for removing nonground measurements, section II].

    Parameters
    ----------
    pieces : (N, 3) points of the world each, z up, metres.
    low, high : (2,) corners of the grid.
    cell_m : side of a cell.
    window_m : whatever is narrower than this and stands out upwards is no ground.
    step_m : how far a cell's lowest point may stand out from level ground.

    Raises
    ------
    ValueError
        If no point lies over the grid.
    """
    shape = np.maximum(np.ceil((high - low) / cell_m).astype(int), 1)
    lowest = np.full(int(shape.prod()), np.inf)
    for xyz in pieces:
        cell = np.floor((xyz[:, :2] - low) / cell_m).astype(np.int64)
        inside = np.all((cell >= 0) & (cell < shape), axis=1)
        flat = cell[inside, 0] * shape[1] + cell[inside, 1]
        np.minimum.at(lowest, flat, xyz[inside, 2].astype(np.float64))
    lowest = lowest.reshape(shape)
    occupied = np.isfinite(lowest)
    if not occupied.any():
        raise ValueError("no point lies over the grid")
    filled = _from_nearest(lowest, occupied)
    seen, window = occupied.copy(), 3
    widest = max(window, min(round(window_m / cell_m), int(shape.max())))
    while True:
        opened = grey_opening(filled, size=(window, window), mode="nearest")
        seen &= lowest - opened <= step_m + GRADE * window * cell_m / 2
        if window == widest:
            break
        window = min(2 * window - 1, widest)
    return GroundGrid(np.asarray(low, np.float64), cell_m, _from_nearest(lowest, seen), seen)


def ground_spread(
    grid: GroundGrid,
    pieces: Iterable[NDArray[np.floating]],
    least_m: float,
    most_m: float,
    share: float,
) -> float:
    """Height above the grid below which points belong to the ground: uneven, or measured badly.

    A ``share`` of the points over seen ground that lie below ``most_m`` lie lower; at least
    ``least_m``.
    """
    heights = [np.empty(0)]
    for xyz in pieces:
        cells, inside = grid.cells(xyz[:, :2])
        above = xyz[:, 2] - grid.height[cells[:, 0], cells[:, 1]]
        on_ground = inside & grid.seen[cells[:, 0], cells[:, 1]] & (above < most_m)
        heights.append(above[on_ground].astype(np.float64))
    above = np.concatenate(heights)
    return max(least_m, float(np.quantile(above, share)) if len(above) else 0.0)


def _from_nearest(values: F64, known: Mask) -> F64:
    """Values of the nearest known cell."""
    nearest = cast(
        "I64", distance_transform_edt(~known, return_distances=False, return_indices=True)
    )
    return values[nearest[0], nearest[1]]
