"""The outline of a model seen from above: the convex hull of its footprint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull


def hull_edges(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges of the convex hull of (N, 2) points: middle and outward unit normal of each."""
    corners = points[ConvexHull(points).vertices]  # counter-clockwise
    ends = np.roll(corners, -1, axis=0)
    along = ends - corners
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.concatenate([(corners + ends) / 2, normal], axis=1)


def outline_points(
    points: NDArray[np.float64], spacing: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points every ``spacing`` along the convex hull of (N, 2) points, and outward normals."""
    corners = points[ConvexHull(points).vertices]  # counter-clockwise
    places, normals = [], []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = float(np.hypot(*(b - a)))
        count = max(1, round(length / spacing))
        along = (np.arange(count) + 0.5) / count
        if length < spacing / 4:
            continue
        places.append(a + along[:, None] * (b - a))
        normals.append(np.tile([(b - a)[1] / length, -(b - a)[0] / length], (count, 1)))
    return np.concatenate(places), np.concatenate(normals)
