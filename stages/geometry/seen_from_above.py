"""Which points of a mesh a sensor sees: from straight above, or from anywhere around.

[Bovenkamp 2010, section 3.2] samples a model where a sensor above it sees it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.random import Generator

from spinpipe.schemas.arrays import F64, I64, Mask
from spinpipe.stages.compiled import inner
from spinpipe.stages.geometry.shapes import Mesh, sample_surface

_ELEVATIONS_DEG = (90.0, 60.0, 30.0, 0.0, -30.0)  # low cameras see what a table top covers
_AZIMUTHS = 12
_MOST_CELLS, _MOST_MEMBERS = 256, 50_000_000
"""Cells of the grid along its longest side, and entries of all of them together."""
_LEAST_SHARE = 0.01
"""Share of points that is reckoned to show at least: bounds how many are drawn at once."""
_FACES_A_CELL = 2.0
"""About so many faces for a cell on one side of a box: a surface crosses few of the cells."""


class FaceGrid(NamedTuple):
    """Faces by the cells of a grid that their bounding boxes touch: rays look only at those."""

    corners: F64
    """(F, 3, 3)."""
    low: F64
    """(3,) corner of the grid."""
    step: float
    cells: I64
    """(3,) along each axis."""
    starts: I64
    """Of cell c the faces are ``members[starts[c]:starts[c + 1]]``."""
    members: I64
    tolerance: float
    """A point on a face must not be hidden by that face: allow for rounding."""

    @classmethod
    def of(cls, mesh: Mesh) -> FaceGrid:
        """Built once for all rays."""
        corners = np.ascontiguousarray(mesh.vertices[mesh.faces])
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        reach = float((high - low).max()) or 1.0
        along = min(_MOST_CELLS, max(1, math.isqrt(int(len(corners) / _FACES_A_CELL))))
        tolerance = 1e-6 * reach
        while True:
            step = reach * (1 + 1e-9) / along
            cells = np.floor((high - low) / step).astype(np.int64) + 1
            counts = _count_members(corners, low, step, cells, tolerance)
            if along == 1 or counts.sum() <= _MOST_MEMBERS:
                break
            along //= 2  # a few large faces among many small ones
        starts = np.concatenate([[0], np.cumsum(counts)])
        members = _fill_members(corners, low, step, cells, tolerance, starts)
        return cls(corners, low, step, cells, starts, members, tolerance)

    def cell_of(self, points: F64) -> I64:
        """Number (N,) of the cell that each of (N, 3) points on the mesh lies in."""
        x, y, z = np.clip((points - self.low) / self.step, 0, self.cells - 1).astype(np.int64).T
        return (x * self.cells[1] + y) * self.cells[2] + z

    def open_towards(self, points: F64, towards: F64) -> Mask:
        """Whether the rays from points (N, 3) along the last row of a rotation meet no face.

        Faces cover whichever side they turn, their borders included. A face that the ray lies in
        covers nothing.
        """
        return _open_towards(np.ascontiguousarray(points), towards[2], *self)


def seen_from_above(points: F64, grid: FaceGrid) -> Mask:
    """Whether nothing of a mesh lies straight above each of its points (N, 3), z up."""
    return grid.open_towards(points, np.eye(3))


def seen_from_around(points: F64, grid: FaceGrid) -> Mask:
    """Whether each point (N, 3) of a mesh, z up, shows from any direction but steeply below.

    What never shows is inside: parts of a model drawn through each other have such faces.
    """
    order = np.argsort(grid.cell_of(points))  # rays of neighbours meet the same faces: cached
    points = points[order]
    seen = np.zeros(len(points), np.bool_)
    for elevation in np.radians(_ELEVATIONS_DEG):
        azimuths = np.arange(_AZIMUTHS if np.cos(elevation) > 1e-9 else 1) * 2 * np.pi / _AZIMUTHS
        for azimuth in azimuths + 0.1:  # off the axes, along which models have upright faces
            rest = np.flatnonzero(~seen)
            seen[rest] = grid.open_towards(points[rest], _turned_upwards(elevation, azimuth))
    return seen[np.argsort(order)]


def sample_seen(
    mesh: Mesh, count: int, seen: Callable[[F64, FaceGrid], Mask], rng: Generator
) -> tuple[F64, F64]:
    """Like ``sample_surface``, but only points that are ``seen``: points and normals (count, 3)."""
    grid = FaceGrid.of(mesh)
    points, normals = np.empty((0, 3)), np.empty((0, 3))
    wanted = count
    while len(points) < count:
        batch, batch_normals = sample_surface(*mesh, wanted, rng)
        shows = seen(batch, grid)
        # a tenth more than fail if as many are hidden again
        share = max(float(shows.mean()), _LEAST_SHARE)
        wanted = math.ceil(1.1 * max(count - len(points) - np.count_nonzero(shows), 1) / share)
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


@njit(cache=True, nogil=True)
def _cells_of(face: F64, low: F64, step: float, cells: I64, margin: float) -> tuple[I64, I64]:
    """First and last cell along each axis that a face may touch."""
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        least = min(face[0, axis], face[1, axis], face[2, axis]) - low[axis] - margin
        most = max(face[0, axis], face[1, axis], face[2, axis]) - low[axis] + margin
        first[axis] = max(0, int(least / step))
        last[axis] = min(cells[axis] - 1, int(most / step))
    return first, last


@njit(cache=True, nogil=True)
def _count_members(corners: F64, low: F64, step: float, cells: I64, margin: float) -> I64:
    counts = np.zeros(cells[0] * cells[1] * cells[2], np.int64)
    for face in range(len(corners)):
        first, last = _cells_of(corners[face], low, step, cells, margin)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    counts[(i * cells[1] + j) * cells[2] + k] += 1
    return counts


@njit(cache=True, nogil=True)
def _fill_members(
    corners: F64, low: F64, step: float, cells: I64, margin: float, starts: I64
) -> I64:
    members, free = np.empty(starts[-1], np.int64), starts[:-1].copy()
    for face in range(len(corners)):
        first, last = _cells_of(corners[face], low, step, cells, margin)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    cell = (i * cells[1] + j) * cells[2] + k
                    members[free[cell]] = face
                    free[cell] += 1
    return members


@njit(cache=True, nogil=True, error_model="numpy")
def _open_towards(
    points: F64,
    ray: F64,
    corners: F64,
    low: F64,
    step: float,
    cells: I64,
    starts: I64,
    members: I64,
    tolerance: float,
) -> Mask:
    """Walk each ray from cell to cell [Amanatides & Woo 1987]."""
    free = np.ones(len(points), np.bool_)
    nx, ny, nz = cells[0], cells[1], cells[2]
    covering = 0
    for n in range(len(points)):
        if _hit(points, n, ray, corners, covering, tolerance):
            free[n] = False  # what covers the point before often covers this one
            continue
        i, side_x, until_x, each_x = _way_along(points[n, 0] - low[0], ray[0], step, nx)
        j, side_y, until_y, each_y = _way_along(points[n, 1] - low[1], ray[1], step, ny)
        k, side_z, until_z, each_z = _way_along(points[n, 2] - low[2], ray[2], step, nz)
        while 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
            here = (i * ny + j) * nz + k
            for m in range(starts[here], starts[here + 1]):
                if _hit(points, n, ray, corners, members[m], tolerance):
                    free[n] = False
                    covering = members[m]
                    break
            if not free[n]:
                break
            if until_x <= until_y and until_x <= until_z:
                i += side_x
                until_x += each_x
            elif until_y <= until_z:
                j += side_y
                until_y += each_y
            else:
                k += side_z
                until_z += each_z
    return free


@inner
def _way_along(at: float, along: float, step: float, cells: int):
    """Along an axis: the cell, where the next one lies, how far that is, and each one after it."""
    cell = min(max(int(at / step), 0), cells - 1)
    if abs(along) < 1e-12:
        return cell, 0, np.inf, np.inf
    border = (cell + (1 if along > 0 else 0)) * step
    return cell, (1 if along > 0 else -1), (border - at) / along, step / abs(along)


@inner
def _hit(points: F64, n: int, ray: F64, corners: F64, m: int, tolerance: float) -> bool:
    """Whether a face lies ahead of a point [Moeller & Trumbore 1997]."""
    ax, ay, az = corners[m, 0, 0], corners[m, 0, 1], corners[m, 0, 2]
    bx, by, bz = corners[m, 1, 0] - ax, corners[m, 1, 1] - ay, corners[m, 1, 2] - az
    cx, cy, cz = corners[m, 2, 0] - ax, corners[m, 2, 1] - ay, corners[m, 2, 2] - az
    rx, ry, rz = ray[0], ray[1], ray[2]
    px, py, pz = ry * cz - rz * cy, rz * cx - rx * cz, rx * cy - ry * cx
    area = bx * px + by * py + bz * pz  # twice the face's, as seen along the ray
    if abs(area) <= tolerance * tolerance:
        return False
    dx, dy, dz = points[n, 0] - ax, points[n, 1] - ay, points[n, 2] - az
    v = (dx * px + dy * py + dz * pz) / area
    if v < -1e-9 or v > 1 + 1e-9:
        return False
    qx, qy, qz = dy * bz - dz * by, dz * bx - dx * bz, dx * by - dy * bx
    w = (rx * qx + ry * qy + rz * qz) / area
    if w < -1e-9 or v + w > 1 + 1e-9:
        return False
    return (cx * qx + cy * qy + cz * qz) / area > tolerance
