"""A bounded sample of a streamed cloud that is uniform in area and independent of order.

One point stays in each occupied voxel: the one whose coordinates have the smallest hash. Voxels
are nested (edges are powers of two), so whenever too many are occupied the edge doubles and the
points kept so far are thinned again. The outcome is the finest grid that fits, whatever the order
of the points and however they are cut into tiles.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F32, I64, U64
from spinpipe.stages.geometry.hashing import GOLDEN, mix

FLOAT32_STEPS = 2.0**24
"""A float32 has 24 significant bits: a finer grid than this share of the extent says nothing."""
SALTS = GOLDEN * np.arange(1, 4, dtype=np.uint64)
"""One for each axis, so that swapped coordinates differ."""


@dataclass(frozen=True)
class AreaSample:
    """One point for each occupied voxel, sorted by hash."""

    points: F32
    """(N, 3) in the frame of the cloud."""
    counts: I64
    """(N,) points of the cloud in each voxel."""
    voxel: float
    """Edge of the voxels, a power of two in units of the cloud."""

    def within(self, voxel: float) -> AreaSample:
        """Return the sample that voxels of a wider edge would have given."""
        cells = np.floor(self.points.astype(np.float64) / voxel).astype(np.int64)
        keys = _hash_rows(cells.view(np.uint64))  # 64 bits: two voxels never share one in practice
        order = np.argsort(keys, kind="stable")  # so the smallest hash of each voxel comes first
        starts = np.flatnonzero(np.diff(keys[order], prepend=~keys[order[:1]]))
        kept = order[starts]
        by_hash = np.argsort(kept)
        totals = np.add.reduceat(self.counts[order], starts) if len(starts) else self.counts
        return AreaSample(self.points[kept[by_hash]], totals[by_hash], voxel)

    def coarser(self) -> AreaSample:
        """Return the sample that voxels of twice the edge would have given."""
        return self.within(2 * self.voxel)

    def fitted(self, limit: int) -> AreaSample:
        """Return the finest sample of at most ``limit`` points."""
        sample = self
        while len(sample.points) > limit:
            # Four doublings at once wherever even they leave too many.
            leap = sample.within(16 * sample.voxel)
            sample = leap if len(leap.points) > limit else sample.coarser()
        return sample


def _hash_rows(columns: U64) -> U64:
    """Hash of each row of (N, 3) 64-bit words."""
    state = np.zeros(len(columns), np.uint64)
    for column, salt in zip(columns.T, SALTS, strict=True):
        state = mix(state ^ (column + salt))
    return state


def _thin(points: F32, counts: I64, voxel: float) -> AreaSample:
    """Keep the point with the smallest hash of each voxel, in the order of the hashes."""
    # -0.0 and 0.0 are one coordinate, so they must be one bit pattern.
    hashes = _hash_rows((points + np.float32(0)).view(np.uint32).astype(np.uint64))
    by_hash = np.argsort(hashes, kind="stable")
    return AreaSample(points[by_hash], counts[by_hash], voxel).within(voxel)


def sample_by_area(
    tiles: Iterable[F32], extent: float, limit: int, *, shared: float = 0.5, least: int = 2000
) -> AreaSample:
    """Sample a cloud uniformly by area with at most ``limit`` points.

    Parameters
    ----------
    tiles
        Pieces of the cloud, each (N, 3) float32.
    extent
        Largest edge of the cloud's bounding box.
    limit
        Most points in the sample.
    shared
        The voxels grow until this share of them holds more than one point, so that the sample
        follows the surface and not the density of the points ...
    least
        ... but not when fewer than this many voxels would be left.

    Returns
    -------
    AreaSample
        The same for every order of the points and every division into tiles.
    """
    smallest = extent / FLOAT32_STEPS if extent > 0 else 1.0  # all points may be one place
    sample = _thin(
        np.empty((0, 3), np.float32),
        np.empty(0, np.int64),
        2.0 ** float(np.ceil(np.log2(smallest))),
    )
    for tile in tiles:
        points = np.ascontiguousarray(tile, np.float32)
        piece = _thin(points, np.ones(len(points), np.int64), sample.voxel)
        piece = piece.fitted(limit)
        both = _thin(
            np.concatenate([sample.points, piece.points]),
            np.concatenate([sample.counts, piece.counts]),
            max(sample.voxel, piece.voxel),
        )
        sample = both.fitted(limit)
    while len(sample.points) > least and np.mean(sample.counts > 1) < shared:
        coarser = sample.coarser()
        if len(coarser.points) < least:
            break
        sample = coarser
    return sample
