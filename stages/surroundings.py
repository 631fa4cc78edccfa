"""The points around candidates, ordered for look-up, with what is measured from them.

Density and noise decide how near is near; both come from the cloud itself. The grid is anchored at
the world's origin, so a tile of a cloud is ordered as the whole cloud is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import percentile_filter
from scipy.special import gammaincinv

from spinpipe.schemas.records import Sampling
from spinpipe.stages.cell_grid import CellGrid
from spinpipe.stages.columns import column_order

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

PATCH_SPACINGS = 5.0
"""Side of the patches whose planes measure the noise, in point spacings: about 25 points."""
PLAIN_PERCENT = 30
"""At least this share of the patches is plain ground."""


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


def measure_sampling(points: NDArray[np.floating]) -> Sampling:
    """Spacing and noise of a cloud.

    Planes z = a + bx + cy are fitted to patches of about 25 points. The noise is the 30th
    percentile of their residuals: at least that share of the patches is plain ground. The spacing
    is that of the median patch of the plainer half: walls, trees, stray points count for nothing.

    Parameters
    ----------
    points : (N, 3), world frame, metres.

    Raises
    ------
    ValueError
        With fewer than 100 points.
    """
    if len(points) < 100:
        raise ValueError(f"{len(points)} points are too few to measure density and noise")
    xyz = np.asarray(points, dtype=np.float64)
    extent = np.ptp(xyz[:, :2], axis=0)
    side = max(float(np.sqrt(extent.prod() / len(xyz))), 1e-3) * PATCH_SPACINGS
    spacing = side / PATCH_SPACINGS
    noise = 0.0
    for _ in range(8):  # the occupied part may be far denser than the bounding box
        order, first = column_order(xyz, side)[:2]
        counts, variance = _patch_planes(xyz[order], first)
        if len(counts) == 0:
            return Sampling(spacing, noise)
        noise = float(np.sqrt(np.percentile(variance, PLAIN_PERCENT)))
        plain = counts[variance <= np.median(variance)]
        spacing = side / float(np.sqrt(np.median(plain)))
        if abs(side / spacing - PATCH_SPACINGS) < 0.1 * PATCH_SPACINGS:
            break
        side = PATCH_SPACINGS * spacing
    return Sampling(spacing, noise)


def _patch_planes(xyz: F64, first: I64) -> tuple[I64, F64]:
    """Points and variance about the plane z = a + bx + cy of each patch of at least 8 points.

    Were all patches plain, ``PLAIN_PERCENT`` of the variances would stay below a certain share of
    the true one [chi-squared distribution]; they are divided by that share.
    """
    counts = np.diff(np.append(first, len(xyz)))
    mean = np.add.reduceat(xyz, first) / counts[:, None]
    centred = xyz - np.repeat(mean, counts, axis=0)
    x, y, z = centred.T
    xx, xy, yy, xz, yz, zz = (
        np.add.reduceat(a * b, first) for a, b in ((x, x), (x, y), (y, y), (x, z), (y, z), (z, z))
    )
    det = xx * yy - xy * xy
    fit = (counts >= 8) & (det > 1e-6 * (xx + yy) ** 2)
    xx, xy, yy, xz, yz, zz, det = (v[fit] for v in (xx, xy, yy, xz, yz, zz, det))
    b, c = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    freedom = counts[fit] - 3
    share = 2 * gammaincinv(freedom / 2, PLAIN_PERCENT / 100) / freedom  # of the chi-squared
    return counts[fit], np.clip(zz - b * xz - c * yz, 0.0, None) / freedom / share


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


def ground_halo_m(sampling: Sampling, reach_m: float) -> float:
    """How far around a place points must be known for ``local_ground`` to be right there."""
    return reach_m + 3.0 * _ground_cell_m(sampling, reach_m)


def _ground_cell_m(sampling: Sampling, reach_m: float) -> float:
    return max(6.0 * sampling.spacing_m, reach_m / 5.0)


def local_ground(xyz: F64, sampling: Sampling, reach_m: float) -> F64:
    """(N,) height of the ground below each of (N, 3) points, world, metres."""
    side = _ground_cell_m(sampling, reach_m)
    order, first, keys, _, cells = column_order(xyz, side)
    counts = np.diff(np.append(first, len(xyz)))
    lowest = np.full(cells[0] * cells[1], np.nan)
    lowest[keys] = xyz[order][first + counts // 20, 2]
    grid = lowest.reshape(cells)
    filled = np.where(np.isnan(grid), np.inf, grid)
    size = 2 * int(np.ceil(reach_m / side)) + 1
    ground = percentile_filter(filled, 5, size=size, mode="constant", cval=np.inf)
    ground = np.where(np.isfinite(ground), ground, np.nanmin(grid))
    column = np.empty(len(xyz), dtype=np.int64)
    column[order] = np.repeat(keys, counts)
    # a twentieth of the points lies about two standard deviations below the surface
    return ground.ravel()[column] + 2.0 * sampling.noise_m
