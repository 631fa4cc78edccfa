"""A model's whole surface as dense points with normals, and how many points of a cloud it gets."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F64, Mask
from spinpipe.schemas.records import ObjectModel
from spinpipe.stages.geometry.seen_from_above import sample_seen, seen_from_around
from spinpipe.stages.geometry.shapes import Mesh

SURFACE_POINTS = 60_000
NORMAL_NEIGHBOURS = 12
"""Points of a cloud that a normal is estimated from."""
TOP_SHARE = 0.05
"""Share of its height by which a model's top may undulate: chosen."""
STRAY_SHARE = 0.02
"""Share of a model's surface that may rise above its top: an antenna, a bump of the reconstruction;
chosen."""
FACES_PER_VOXEL = 1.5
"""Mean number of voxels of side v that a surface of area v^2 touches, over all its directions."""


def model_surface(model: ObjectModel, rng: np.random.Generator) -> tuple[F64, F64]:
    """Points (N, 3) and unit normals (N, 3) of a model, object frame, metres.

    A mesh is sampled anew, wherever it shows from around. A cloud comes as it is; where it has no
    normals they are those of planes through neighbouring points, of either sign.
    """
    if len(model.faces):
        mesh = Mesh(model.vertices.astype(np.float64), model.faces.astype(np.int64))
        return sample_seen(mesh, SURFACE_POINTS, seen_from_around, rng)
    points = model.points.astype(np.float64)
    normals = model.normals.astype(np.float64)
    known = np.linalg.norm(normals, axis=1) > 0
    if not known.all():
        normals[~known] = _plane_normals(points, points[~known])
    return points, normals


def _plane_normals(points: F64, at: F64) -> F64:
    """Normals of the planes through the nearest ``points`` of each place."""
    _, rows = KDTree(points).query(at, k=min(NORMAL_NEIGHBOURS, len(points)))
    near = points[np.asarray(rows).reshape(len(at), -1)]
    centred = near - near.mean(axis=1, keepdims=True)
    # eigenvectors come in ascending order: the first is the direction of least spread
    return np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))[1][:, :, 0]


def points_on(points: NDArray[np.floating], density: float, voxels_along: int = 40) -> float:
    """How many points a cloud has on a surface that (N, 3) points sample densely.

    The area follows from the voxels that they fall into; ``density`` is the cloud's, per square
    metre.
    """
    voxel_m = float(np.ptp(points, axis=0).max()) / voxels_along
    if voxel_m == 0:
        return 0.0
    occupied = np.unique(np.floor(points / voxel_m).astype(np.int64), axis=0)
    return len(occupied) * voxel_m**2 / FACES_PER_VOXEL * density


def top_of(points: NDArray[np.floating]) -> Mask:
    """(N,) which of (N, 3) points on a model, object frame, z up, make its top.

    Those within ``TOP_SHARE`` of its height of a level that only strays lie above.
    """
    level = np.quantile(points[:, 2], 1.0 - STRAY_SHARE)
    return points[:, 2] > (1.0 - TOP_SHARE) * level


def topmost_point(points: NDArray[Any], tolerance_m: float = 1e-3) -> F64:
    """Topmost point of an object (object frame, z up, metres).

    A flat top has many highest points: of those within ``tolerance_m`` of the highest the one
    nearest to their horizontal mean is taken, at the highest's height.

    Returns
    -------
    (3,) float64 array
    """
    cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if len(cloud) == 0 or not np.isfinite(cloud).all():
        raise ValueError("topmost_point: the cloud is empty or holds NaN or infinite numbers")
    top = cloud[:, 2].max()
    near = cloud[cloud[:, 2] >= top - tolerance_m, :2]
    centre = near[np.argmin(np.sum((near - near.mean(axis=0)) ** 2, axis=1))]
    return np.array([centre[0], centre[1], top])
