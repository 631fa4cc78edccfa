"""Points in order for the spin scan: by horizontal cell, and by height inside a cell.

A spin image needs the points within a vertical cylinder and a window of heights. Sorted this way,
what a cell contributes is one contiguous run, found by binary search, and a cell whose bounds lie
outside is skipped without touching its points.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F32, F64, I64
from spinpipe.stages.geometry.columns import key_and_height
from spinpipe.stages.scan.gather import PAD

POINTS_PER_CELL = 128
"""Aim of the side of a cell unless given."""


class SpinIndex(NamedTuple):
    """World points sorted by cell and height.

    Only cells that hold points are stored, so far outliers cost nothing.

    Attributes
    ----------
    xyz : (3, N + PAD) float32 array
        Coordinates, one row an axis, followed by padding.
    start : (C + 1,) int64 array
        First point of each cell.
    key : (C,) int64 array
        ``ix * stride + iy``, ascending.
    bounds : (6, C) float32 array
        Least x, greatest x, least y, greatest y, lowest and highest z of each cell's points.
    corner : (2,) float64 array
        Horizontal position of the first cell's corner, metres.
    cells : (2,) int64 array
        Number of cells along x and y; the second is the stride of ``key``.
    cell_m : float
        Side of a cell.
    """

    xyz: F32
    start: I64
    key: I64
    bounds: F32
    corner: F64
    cells: I64
    cell_m: float

    @property
    def size(self) -> int:
        """Number of points."""
        return int(self.start[-1])


def build_index(points: NDArray[Any], cell_m: float | None = None) -> SpinIndex:
    """Sort points for the scan.

    Parameters
    ----------
    points : (N, 3) array
        Upright, z up, metres; taken as float32. May be empty.
    cell_m : float, optional
        Side of a cell, metres; from the density if not given. It changes the speed, never a result.

    Raises
    ------
    ValueError
        A coordinate is not finite.
    """
    cloud = np.asarray(points, dtype=np.float32).reshape(-1, 3)
    if not np.isfinite(cloud).all():
        raise ValueError("build_index: the cloud holds NaN or infinite coordinates; drop them")
    side = cell_m or side_for(cloud, POINTS_PER_CELL)
    if len(cloud) == 0:
        return SpinIndex(
            xyz=np.zeros((3, PAD), np.float32),
            start=np.zeros(1, np.int64),
            key=np.zeros(0, np.int64),
            bounds=np.zeros((6, 0), np.float32),
            corner=np.zeros(2),
            cells=np.ones(2, np.int64),
            cell_m=side,
        )
    order, key, corner, cells, side = sort_by_cell(cloud, side)
    xyz = np.zeros((3, len(cloud) + PAD), np.float32)
    for axis in range(3):
        np.take(cloud[:, axis], order, out=xyz[axis, : len(cloud)])
    first = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    start = np.r_[first, len(cloud)]
    x, y, z = xyz[:, : len(cloud)]
    bounds = np.stack(
        [
            np.minimum.reduceat(x, first),
            np.maximum.reduceat(x, first),
            np.minimum.reduceat(y, first),
            np.maximum.reduceat(y, first),
            z[first],
            z[start[1:] - 1],
        ]
    )
    return SpinIndex(xyz, start, key[first], bounds, corner, cells, side)


def sort_by_cell(cloud: F32, side: float) -> tuple[NDArray[np.intp], I64, F64, I64, float]:
    """Order points by horizontal cell, then by height.

    Parameters
    ----------
    cloud : (N, 3) float32 array
        At least one point.
    side : float
        Side of a cell, metres.

    Returns
    -------
    order : (N,) array
    key : (N,) int64 array
        Cell of each point in that order, ``ix * cells[1] + iy``.
    corner : (2,) float64 array
        Corner of the first cell.
    cells : (2,) int64 array
        Number of cells along x and y.
    side : float
        As given, or larger where the keys would not fit 63 bits.
    """
    x, y, z = np.ascontiguousarray(cloud.T)
    corner = np.array([x.min(), y.min()], np.float64)
    span = np.array([x.max(), y.max()], np.float64) - corner
    side = max(side, float(span.max()) * 2.0**-30)
    cells = (span / side).astype(np.int64) + 1
    key = ((x - corner[0]) / side).astype(np.int64) * cells[1]
    key += ((y - corner[1]) / side).astype(np.int64)
    order = np.argsort(key_and_height(key, z))
    return order, key[order], corner, cells, side


def side_for(cloud: F32, points: float) -> float:
    """Side of a square that holds about so many points of a cloud, metres.

    Measured in the middle nine tenths along x and y: outliers are ignored.
    """
    if len(cloud) == 0:
        return 1.0
    sample = cloud[:: max(1, len(cloud) // 10_000), :2].astype(np.float64)
    low, high = np.quantile(sample, [0.05, 0.95], axis=0)
    width, depth = high - low
    share = points / len(cloud)
    side = max(np.sqrt(width * depth * share / 0.81), max(width, depth) * share / 0.9)
    return float(side) if side > 0 else 1.0
