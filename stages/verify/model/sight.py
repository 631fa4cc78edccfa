"""What of a model is seen from above: its outline, and which side of its surface the air is on."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from spinpipe.schemas.arrays import F64, Mask

# Directions from which the model is looked at, to tell its body from the air around it: straight
# down, then rings of eight. Lower rays would look underneath the model.
_ELEVATIONS_DEG = (60.0, 40.0, 25.0)
_AZIMUTHS = 8


def open_air(
    surface: Mask,
) -> tuple[Mask, Mask]:
    """Voxels that a ray from above reaches, and those that a steep one (60 degrees up) does."""
    nx, ny, nz = surface.shape
    seen = np.zeros_like(surface)
    steep = np.zeros_like(surface)
    directions = [(0.0, 0.0, True)]
    for elevation in _ELEVATIONS_DEG:
        run = 1 / np.tan(np.radians(elevation))
        for k in range(_AZIMUTHS):
            angle = 2 * np.pi * k / _AZIMUTHS
            directions.append((run * np.cos(angle), run * np.sin(angle), elevation >= 60))
    for dx, dy, is_steep in directions:
        # the shadow of everything above, carried down one layer at a time along the ray
        steps = int(np.ceil(max(abs(dx), abs(dy)))) + 1
        pad = int(np.ceil(max(abs(dx), abs(dy)) * (nz + 1))) + 1
        shadow = np.zeros((nx + 2 * pad, ny + 2 * pad), dtype=bool)
        for k in range(nz - 1, -1, -1):
            i = pad + round(dx * (nz - 1 - k))
            j = pad + round(dy * (nz - 1 - k))
            window = shadow[i : i + nx, j : j + ny]
            lit = ~window
            seen[:, :, k] |= lit
            if is_steep:
                steep[:, :, k] |= lit
            for step in range(steps):  # a low ray crosses several voxels of one layer
                depth = nz - 1 - k + step / steps
                i, j = pad + round(dx * depth), pad + round(dy * depth)
                shadow[i : i + nx, j : j + ny] |= surface[:, :, k]
    return seen, steep


def reached(
    points: F64,
    grid: Mask,
    origin: F64,
    voxel: float,
) -> Mask:
    """Whether the voxels of points are set in a grid."""
    cell = np.floor((points - origin) / voxel).astype(int)
    cell = np.clip(cell, 0, np.array(grid.shape) - 1)
    return grid[cell[:, 0], cell[:, 1], cell[:, 2]]


def turned_outward(
    samples: F64,
    normals: F64,
    air: Mask,
    origin: F64,
    voxel: float,
) -> F64:
    """Normals turned to the side where the air is, if it is on one side only."""
    ahead = reached(samples + 2 * voxel * normals, air, origin, voxel)
    behind = reached(samples - 2 * voxel * normals, air, origin, voxel)
    lit = reached(samples, air, origin, voxel)  # not through a thin plate
    return np.where((lit & behind & ~ahead)[:, None], -normals, normals)


def hull_edges(points: F64) -> F64:
    """Edges of the convex hull of (N, 2) points: middle and outward unit normal of each."""
    corners = points[ConvexHull(points).vertices]  # counter-clockwise
    ends = np.roll(corners, -1, axis=0)
    along = ends - corners
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.concatenate([(corners + ends) / 2, normal], axis=1)


def outline_points(points: F64, spacing: float) -> tuple[F64, F64]:
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
