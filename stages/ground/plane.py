"""Planes of a point sample, and the planes of its points' neighbourhoods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F64

NEIGHBOURS, MOST = 16, 64
"""Points in a local plane: to begin with, and where noise asks for more."""
NORMAL_ERROR = np.radians(4.0)
"""Standard error of normals that are known: a fifth of the slope that ground may have."""
SMOOTHEST = 0.1
"""Share of the surface that is smooth in every scene."""
TRIED = 4096
"""Points that tell whether neighbourhoods are wide enough."""
LEAST_SUPPORT = 500
"""Points of which neighbourhoods are made at least."""
CHUNK = 8192
"""Points whose neighbourhoods are held at once."""


@dataclass(frozen=True)
class FittedPlane:
    """``dot(normal, p) + offset = 0`` with a unit normal of either sign."""

    normal: F64
    offset: float
    inlier_distance: float
    """Points nearer than this are inliers: three standard deviations of their noise."""

    def heights(self, points: F64) -> F64:
        """Signed distances of (N, 3) points from the plane."""
        return points @ self.normal + self.offset

    def flipped(self) -> FittedPlane:
        """Return the same plane with its normal on the other side."""
        return FittedPlane(-self.normal, -self.offset, self.inlier_distance)


@dataclass(frozen=True)
class LocalPlanes:
    """The plane of each point and its nearest neighbours."""

    normals: F64
    """(N, 3) unit normals of either sign."""
    deviations: F64
    """(N,) standard deviation of the neighbours from the plane."""
    errors: F64
    """(N,) standard error of the normals about the axis that is known worst, radians."""


def local_planes(
    points: F64, *, neighbours: int = 16, support: F64 | None = None, rows: int | None = None
) -> LocalPlanes:
    """Principal components of each point's nearest neighbours [Hoppe et al. 1992].

    Parameters
    ----------
    points
        (N, 3), N >= 4.
    neighbours
        Points in each plane.
    support
        (M, 3) points that the neighbours are taken from; the points themselves if not stated.
    rows
        How many of the points, from the first, get a plane; all if not stated.
    """
    support = points if support is None else support
    neighbours = min(neighbours, len(support))
    tree = KDTree(support)
    parts = [
        _principal_planes(support[tree.query(part, k=neighbours)[1]])
        for part in np.split(points[:rows], range(CHUNK, len(points[:rows]), CHUNK))
    ]
    return LocalPlanes(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _principal_planes(patches: F64) -> tuple[F64, F64, F64]:
    """Normals, deviations and errors of (N, K, 3) patches.

    The error is that of a sample's eigenvector towards the next one [Anderson 1963, theorem 1]:
    it grows without bound as a patch gets as thick as it is wide.
    """
    count = patches.shape[1]
    patches = patches - patches.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", patches, patches))
    least, middle = np.maximum(values[:, 0], 0), np.maximum(values[:, 1], 0)
    # Three parameters were fitted to each patch.
    deviations = np.sqrt(least / max(count - 3, 1))
    gap = np.maximum(middle - least, np.finfo(float).tiny)
    return vectors[:, :, 0], deviations, np.sqrt(least / gap * (middle / gap) / count)


def reliable_local_planes(points: F64) -> LocalPlanes:
    """Local planes in neighbourhoods that are wide against the noise.

    A ball that is no wider than the noise is thick holds a round heap of points, whose normal is
    chance and whose deviation says how large the ball is, not how large the noise. So the number
    of neighbours doubles until the smoothest patches know their normals; beyond ``MOST`` of them
    every other point is left out, which widens the ball at the same cost.

    Parameters
    ----------
    points
        (N, 3), N >= 4, in random order.
    """
    neighbours, support = NEIGHBOURS, points
    while True:
        tried = local_planes(points, neighbours=neighbours, support=support, rows=TRIED)
        if np.quantile(tried.errors, SMOOTHEST) <= NORMAL_ERROR:
            break
        if neighbours < MOST:
            neighbours *= 2
        elif len(support) >= 2 * LEAST_SUPPORT:
            support = support[: len(support) // 2]
        else:
            break  # a volume: it has no planes, however wide one looks
    return local_planes(points, neighbours=neighbours, support=support)


def is_collinear(points: F64, *, tolerance: float = 1e-6) -> bool:
    """Whether (N, 3) points span no plane."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return len(spread) < 2 or bool(spread[1] <= tolerance * spread[0])
