"""How a cloud samples its surfaces: how far apart its points are and how far off."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from spinpipe.schemas.arrays import F64, I64
from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.columns import column_order

PATCH_SPACINGS = 5.0
"""Side of the patches whose planes measure the noise, in point spacings: about 25 points."""
PLAIN_PERCENT = 30
"""At least this share of the patches is plain ground."""


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
