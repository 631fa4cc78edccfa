"""Which points of a mesh a sensor sees: from straight above, or from anywhere around.

[Bovenkamp 2010, section 3.2] samples a model where a sensor above it sees it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.random import Generator

from spinpipe.schemas.arrays import F64, I64, Mask
from spinpipe.stages.geometry.shapes import Mesh, sample_surface

_ELEVATIONS_DEG = (90.0, 60.0, 30.0, 0.0, -30.0)  # low cameras see what a table top covers
_AZIMUTHS = 12


def seen_from_around(points: F64, vertices: F64, faces: I64) -> Mask:
    """Whether each point of a mesh shows from any direction but steeply below.

    What never shows is inside: parts of a model drawn through each other have such faces.

    Parameters
    ----------
    points : (N, 3) float64
        Points on the mesh, z up.
    vertices : (V, 3) float64, same unit and frame
    faces : (F, 3) int

    Returns
    -------
    (N,) bool
    """
    seen = np.zeros(len(points), np.bool_)
    for elevation in np.radians(_ELEVATIONS_DEG):
        azimuths = np.arange(_AZIMUTHS if np.cos(elevation) > 1e-9 else 1) * 2 * np.pi / _AZIMUTHS
        for azimuth in azimuths + 0.1:  # off the axes, along which models have upright faces
            rest = np.flatnonzero(~seen)
            towards = _turned_upwards(elevation, azimuth)
            seen[rest] = seen_from_above(points[rest] @ towards.T, vertices @ towards.T, faces)
    return seen


def sample_seen(
    mesh: Mesh, count: int, seen: Callable[[F64, F64, I64], Mask], rng: Generator
) -> tuple[F64, F64]:
    """Like ``sample_surface``, but only points that are ``seen``: points and normals (count, 3)."""
    points, normals = np.empty((0, 3)), np.empty((0, 3))
    while len(points) < count:
        batch, batch_normals = sample_surface(*mesh, count, rng)
        shows = seen(batch, *mesh)
        points = np.concatenate([points, batch[shows]])
        normals = np.concatenate([normals, batch_normals[shows]])
    return points[:count], normals[:count]


def _turned_upwards(elevation: float, azimuth: float) -> F64:
    """Rotation (3, 3) that turns a direction to +z."""
    direction = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    side = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([side, np.cross(direction, side), direction])


def seen_from_above(points: F64, vertices: F64, faces: I64) -> Mask:
    """Whether the vertical ray upwards from each point meets no other face of the mesh.

    Faces cover what lies below them whichever side they turn down, their borders included. A face
    that stands exactly upright covers nothing.

    Parameters
    ----------
    points : (N, 3) float64
        Points on the mesh, z up.
    vertices : (V, 3) float64, same unit and frame
    faces : (F, 3) int

    Returns
    -------
    (N,) bool
    """
    corners = np.ascontiguousarray(vertices[faces])
    low, high = corners.min(axis=1), corners.max(axis=1)
    base, top = low[:, :2].min(axis=0), high[:, :2].max(axis=0)
    reach = float((top - base).max())
    if reach <= 0:
        return np.ones(len(points), np.bool_)
    # About one cell a face on each row of a grid over the horizontal bounding box
    cells = max(1, min(1024, math.isqrt(len(faces))))
    step = reach * (1 + 1e-9) / cells
    first = ((low[:, :2] - base) / step).astype(np.int64)
    last = ((high[:, :2] - base) / step).astype(np.int64)
    starts, members = _faces_by_cell(first, last, cells)
    cell = np.clip(((points[:, :2] - base) / step).astype(np.int64), 0, cells - 1)
    # A point on a face must not be hidden by that face: allow for rounding
    size = float(np.ptp(vertices[faces.ravel()], axis=0).max())
    return _open_above(
        points, corners, cell[:, 0] * cells + cell[:, 1], starts, members, 1e-6 * size
    )


def _faces_by_cell(first: I64, last: I64, cells: int) -> tuple[I64, I64]:
    """Faces whose bounding boxes touch cell c, as ``members[starts[c]:starts[c + 1]]``."""
    counts = (last - first + 1).prod(axis=1)
    face = np.repeat(np.arange(len(first)), counts)
    index = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    wide = (last - first + 1)[face, 1]
    cell = (first[face, 0] + index // wide) * cells + first[face, 1] + index % wide
    order = np.argsort(cell, kind="stable")
    starts = np.searchsorted(cell[order], np.arange(cells * cells + 1))
    return starts, face[order]


@njit(cache=True, nogil=True)
def _open_above(
    points: F64, corners: F64, cell: I64, starts: I64, members: I64, tolerance: float
) -> Mask:
    free = np.ones(len(points), np.bool_)
    for i in range(len(points)):
        x, y, z = points[i]
        for k in range(starts[cell[i]], starts[cell[i] + 1]):
            a, b, c = corners[members[k]]
            # Barycentric coordinates of (x, y) in the face seen from above
            area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
            if abs(area) <= tolerance * tolerance:
                continue
            v = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
            w = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
            if min(v, w, 1 - v - w) < -1e-9:
                continue
            if a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2]) > z + tolerance:
                free[i] = False
                break
    return free
