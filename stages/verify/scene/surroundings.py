"""The points around candidates, ordered for look-up, with what is measured from them.

Density and noise decide how near is near; both come from the cloud itself. The grid is anchored at
the world's origin, so a tile of a cloud is ordered as the whole cloud is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.records import F64, I64, Sampling
from spinpipe.stages.geometry.columns import column_order
from spinpipe.stages.geometry.local_ground import local_ground
from spinpipe.stages.verify.scene.cell_grid import CellGrid


@dataclass(frozen=True, eq=False)
class Surroundings:
    """World points sorted by cell of a square grid.

    Attributes
    ----------
    points : (N, 3) float64, sorted by cell, then by height.
    weights : (N,) float64, 1 / number of points in the same voxel: equal surface, equal weight.
    heights : (N,) float64, above the local ground, metres.
    start : (cx * cy + 1,) int64, first point of each cell.
    cells : (2,) int64, number of cells along x and y.
    corner : (2,) float64, metres.
    cell_m : pitch of the grid.
    sampling : of the whole cloud.
    """

    points: F64
    weights: F64
    heights: F64
    start: I64
    cells: I64
    corner: F64
    cell_m: float
    sampling: Sampling

    @property
    def grid(self) -> CellGrid:
        """The points as kernels walk over them."""
        rows, columns = (int(n) for n in self.cells)
        return CellGrid(
            self.points,
            self.weights,
            self.heights,
            self.start,
            rows,
            columns,
            self.corner,
            float(self.cell_m),
            float(self.sampling.density),
        )

    def ground_at(self, xy: F64) -> F64:
        """Height of the local ground at (K, 2) places: that under a point of the cell there.

        An empty cell takes a point of the next one that is not.
        """
        cell = np.floor((xy - self.corner) / self.cell_m).astype(np.int64)
        cell = np.clip(cell, 0, self.cells - 1)
        first = self.start[cell[:, 0] * self.cells[1] + cell[:, 1]]
        first = np.minimum(first, len(self.points) - 1)
        return self.points[first, 2] - self.heights[first]


def build_surroundings(
    points: NDArray[np.floating], sampling: Sampling, ground_reach_m: float
) -> Surroundings:
    """Order points for look-up and find the local ground.

    The local ground is a low percentile of the low percentiles of cells within
    ``ground_reach_m``: it must reach beyond whatever stands on it.

    Parameters
    ----------
    points : (N, 3), world frame, metres; at least one.
    sampling : of the whole cloud.
    ground_reach_m : how far from an object's middle its ground is surely seen.
    """
    xyz = np.asarray(points, dtype=np.float64)
    cell_m = 2.0 * sampling.spacing_m
    order, first, keys, low, cells = column_order(xyz, cell_m)
    xyz = xyz[order]
    start = np.searchsorted(
        np.repeat(keys, np.diff(np.append(first, len(xyz)))), np.arange(cells[0] * cells[1] + 1)
    )
    level = np.floor(xyz[:, 2] / cell_m).astype(np.int64)
    column = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(xyz))))
    # points are sorted by height within their column: a voxel is one run
    fresh = np.r_[True, (np.diff(level) != 0) | (np.diff(column) != 0)]
    run = np.cumsum(fresh) - 1
    weights = 1.0 / np.bincount(run)[run]
    return Surroundings(
        points=xyz,
        weights=weights,
        heights=xyz[:, 2] - local_ground(xyz, sampling, ground_reach_m),
        start=start.astype(np.int64),
        cells=np.asarray(cells, dtype=np.int64),
        corner=np.asarray(low, dtype=np.float64) * cell_m,
        cell_m=cell_m,
        sampling=sampling,
    )
