"""How a cloud samples its surfaces: how far apart its points are and how far off."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from spinpipe.schemas.arrays import F64, I64, U64
from spinpipe.schemas.records import ErrorOver, Sampling
from spinpipe.stages.geometry.columns import column_order
from spinpipe.stages.geometry.hashing import GOLDEN, mix

PATCH_SPACINGS = 5.0
"""Side of the patches whose planes measure the noise, in point spacings: about 25 points."""
PLAIN_PERCENT = 30
"""At least this share of the patches is plain ground."""
SCALES, FEWEST_CELLS, FEWEST_POINTS = 4, 20, 8
"""Sides of cells in which the error is measured, each twice the last: 5 to 40 spacings."""
_ENOUGH_POINTS = 300_000
"""Of a larger cloud about so many are looked at, square by square of the largest side."""
_THINNEST = 0.1
"""Points that reach less far, in their cell's side, show no plane."""


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
            break
        noise = _plain_error(variance)
        plain = counts[variance <= np.median(variance)]
        spacing = side / float(np.sqrt(np.median(plain)))
        if abs(side / spacing - PATCH_SPACINGS) < 0.1 * PATCH_SPACINGS:
            break
        side = PATCH_SPACINGS * spacing
    return Sampling(spacing, noise, tuple(_errors(xyz, PATCH_SPACINGS * spacing)))


def _errors(xyz: F64, side_m: float) -> Iterator[ErrorOver]:
    """Distance from planes through the points in cubes of growing side.

    Unlike the noise above, walls, ceilings and points far below count for nothing: they lie in
    cubes of their own. Each column of cubes begins at another height, so that few cut a surface.
    """
    if len(xyz) > _ENOUGH_POINTS:
        squares = _columns(xyz, side_m * 2.0 ** (SCALES - 1))
        xyz = xyz[squares <= np.uint64(_ENOUGH_POINTS / len(xyz) * 2.0**64)]
    for side in side_m * 2.0 ** np.arange(SCALES):
        column = _columns(xyz, side)
        begins = (column >> np.uint64(40)) / 2.0**24
        level = np.floor(xyz[:, 2] / side + begins).astype(np.int64).view(np.uint64)
        key = mix(column + level * GOLDEN)
        order = np.argsort(key, kind="stable")
        key, ordered = key[order], xyz[order]
        first = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
        counts = np.diff(np.append(first, len(xyz)))
        many = counts >= FEWEST_POINTS
        covariance = np.empty((np.count_nonzero(many), 3, 3))
        mean = np.add.reduceat(ordered, first) / counts[:, None]
        columns = np.ascontiguousarray((ordered - np.repeat(mean, counts, axis=0)).T)
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            sums = np.add.reduceat(columns[i] * columns[j], first) / counts
            covariance[:, i, j] = covariance[:, j, i] = sums[many]
        spread = np.linalg.eigvalsh(covariance)
        plane = spread[:, 1] > (_THINNEST * side) ** 2
        if np.count_nonzero(plane) < FEWEST_CELLS:
            return
        counts, least = counts[many][plane], np.clip(spread[plane, 0], 0.0, None)
        freedom = counts - 3
        yield ErrorOver(float(side), _plain_error(least * counts / freedom / _plain_share(freedom)))


def _columns(xyz: F64, side_m: float) -> U64:
    """A number spread evenly for the square column that each point lies in."""
    cell = np.floor(xyz[:, :2] / side_m).astype(np.int64).view(np.uint64)
    return mix(cell[:, 0] * GOLDEN + cell[:, 1])


def _plain_error(variance: F64) -> float:
    return float(np.sqrt(np.percentile(variance, PLAIN_PERCENT)))


def _plain_share(freedom: I64) -> F64:
    """Share of the true variance below which ``PLAIN_PERCENT`` of plain patches stay.

    Quantile of the chi-squared distribution.
    """
    return 2 * gammaincinv(freedom / 2, PLAIN_PERCENT / 100) / freedom


def _patch_planes(xyz: F64, first: I64) -> tuple[I64, F64]:
    """Points and variance about the plane z = a + bx + cy of each patch of at least 8 points.

    Divided by ``_plain_share``, so that the percentile is the true one.
    """
    counts = np.diff(np.append(first, len(xyz)))
    mean = np.add.reduceat(xyz, first) / counts[:, None]
    x, y, z = (xyz[:, axis] - np.repeat(mean[:, axis], counts) for axis in range(3))
    xx, xy, yy, xz, yz, zz = (
        np.add.reduceat(a * b, first) for a, b in ((x, x), (x, y), (y, y), (x, z), (y, z), (z, z))
    )
    det = xx * yy - xy * xy
    fit = (counts >= 8) & (det > 1e-6 * (xx + yy) ** 2)
    xx, xy, yy, xz, yz, zz, det = (v[fit] for v in (xx, xy, yy, xz, yz, zz, det))
    b, c = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    freedom = counts[fit] - 3
    rest = np.clip(zz - b * xz - c * yz, 0.0, None)
    return counts[fit], rest / freedom / _plain_share(freedom)
