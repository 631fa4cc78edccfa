"""A part of a cloud that keeps its density: whole squares, the same for any tiling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.records import F32
from spinpipe.stages.geometry.world_cloud import WorldCloud

SQUARES_ALONG = 64
"""Squares along the scene's diagonal."""


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


def _fraction(square: NDArray[np.int64]) -> NDArray[np.float64]:
    """A number in 0..1 for each (N, 2) square: splitmix64 of its packed indices [Steele 2014]."""
    with np.errstate(over="ignore"):
        z = square[:, 0].astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z += square[:, 1].astype(np.uint64) * np.uint64(0xD1B54A32D192ED03)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((z ^ (z >> np.uint64(31))) >> np.uint64(11)).astype(np.float64) * 2.0**-53
