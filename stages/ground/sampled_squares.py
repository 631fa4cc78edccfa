"""A part of a cloud that keeps its density: whole squares, the same for any tiling."""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.arrays import F32, F64, I64
from spinpipe.stages.geometry.hashing import GOLDEN, mix
from spinpipe.stages.geometry.world_cloud import WorldCloud

SQUARES_ALONG = 64
"""Squares along the scene's diagonal."""
_OTHER = np.uint64(0xD1B54A32D192ED03)
"""An odd number unlike ``GOLDEN``, so that swapped indices differ."""


def points_of_some_squares(cloud: WorldCloud, diagonal_m: float, max_points: int) -> F32:
    """Points of as many squares, spread at random over the scene, as hold about ``max_points``.

    Which squares are taken follows from a hash of their place, so neither tiles nor the order of
    points matter. A cloud of at most ``max_points`` comes whole.

    Parameters
    ----------
    cloud : the whole cloud.
    diagonal_m : of the cloud's bounding box, sets the size of the squares.
    max_points : about how many points to give.

    Returns
    -------
    (N, 3) float32, world, in lexicographic order.
    """
    total = sum(cloud.counts)
    share = max_points / max(total, 1)
    side_m = diagonal_m / SQUARES_ALONG
    found = [np.empty((0, 3), np.float32)]
    for tile in range(len(cloud)):
        xyz = cloud.points(tile)
        if share < 1 and side_m > 0:
            xyz = xyz[_fraction(np.floor(xyz[:, :2] / side_m).astype(np.int64)) < share]
        found.append(xyz)
    points = np.concatenate(found)
    return points[np.lexsort(points.T[::-1])]


def _fraction(square: I64) -> F64:
    """A number in 0..1 for each (N, 2) square, by a hash of its indices."""
    x, y = square.astype(np.uint64).T
    return (mix(x * GOLDEN + y * _OTHER) >> np.uint64(11)).astype(np.float64) * 2.0**-53
