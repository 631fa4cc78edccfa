"""Voxels of the world: one point that stands for each, and which of them touch.

The grid is anchored at the world's origin and nothing depends on the order of points, so a tile of
a cloud gives what the whole cloud gives for it, away from its border.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F32, F64, I64, Mask


@dataclass(frozen=True, eq=False)
class Voxels:
    """The voxels that points lie in.

    Attributes
    ----------
    key : (N,) int64
        Voxel of each point.
    steps : (27,) int64
        What leads from the key of a voxel to those of itself and of the voxels that touch it.
    representatives : (V,) int64
        Row of one point of each voxel, ascending: the nearest to its centre, of several those of
        the lexicographically least coordinates, of equal ones the first.
    """

    key: I64
    steps: I64
    representatives: I64

    @classmethod
    def of(cls, points: F32, side_m: float) -> Voxels:
        """Voxels of points (N, 3), world, metres; ``side_m`` is their side."""
        if len(points) == 0:
            return cls(np.empty(0, np.int64), np.zeros(27, np.int64), np.empty(0, np.int64))
        place = points.astype(np.float64) / side_m
        voxel = np.floor(place).astype(np.int64)
        distance = np.sum((place - voxel - 0.5) ** 2, axis=1)
        voxel -= voxel.min(axis=0) - 1
        if np.prod((voxel.max(axis=0) + 2).astype(np.float64)) >= 2.0**62:
            voxel = np.stack([_without_gaps(axis) for axis in voxel.T], axis=1)
        _, ny, nz = (voxel.max(axis=0) + 2).tolist()
        stride = np.array([ny * nz, nz, 1])
        near = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 3)
        key = voxel @ stride
        return cls(key, near @ stride, _nearest_to_centre(points, key, distance))

    def represents(self) -> Mask:
        """(N,) whether each point represents its voxel."""
        chosen = np.zeros(len(self.key), np.bool_)
        chosen[self.representatives] = True
        return chosen

    def touching(self, rows: I64) -> Mask:
        """(N,) whether each point's voxel is that of one of ``rows`` or touches it."""
        wanted = np.unique(self.key[rows])
        wanted = np.unique(wanted[:, None] + self.steps)
        if len(wanted) == 0:
            return np.zeros(len(self.key), np.bool_)
        at = np.searchsorted(wanted, self.key)
        return wanted[np.minimum(at, len(wanted) - 1)] == self.key


def _without_gaps(axis: I64) -> I64:
    """Coordinates with wide gaps made small: neighbours stay neighbours, others stay apart."""
    values, inverse = np.unique(axis, return_inverse=True)
    steps = np.minimum(np.diff(values, prepend=values[0] - 1), 2)
    return np.cumsum(steps)[inverse]


def _nearest_to_centre(points: F32, key: I64, distance: F64) -> I64:
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(np.diff(key[order], prepend=key[order[0]] - 1))
    least = np.minimum.reduceat(distance[order], first)
    count = np.diff(first, append=len(order))
    nearest = order[distance[order] == np.repeat(least, count)]  # mostly one a voxel
    x, y, z = points[nearest].T
    nearest = nearest[np.lexsort((nearest, z, y, x, key[nearest]))]
    return np.sort(nearest[np.diff(key[nearest], prepend=key[nearest[0]] - 1) != 0])
