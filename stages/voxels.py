"""One point for each voxel of the world, chosen the same way whatever the tiles are."""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.records import F32, I64


def voxel_representatives(points: F32, around: F32, side_m: float) -> I64:
    """Rows of ``points`` that represent their voxel: the nearest to its centre.

    Ties go to the lexicographically least coordinates; of equal points only the first remains.

    Parameters
    ----------
    points : (N, 3) float32
        World, metres.
    around : (M, 3) float32
        All points that may share a voxel with ``points``, themselves among them.
    side_m : float
        Side of a voxel.

    Returns
    -------
    (R,) int64
        Ascending.
    """
    if len(points) == 0:
        return np.empty(0, np.int64)
    own = np.zeros(len(around) + len(points), bool)
    own[: len(points)] = True
    everything = np.concatenate([points, around]).astype(np.float64)
    voxel = np.floor(everything / side_m)
    distance = np.sum((everything / side_m - voxel - 0.5) ** 2, axis=1)
    # Own points come before their copies in ``around``, so that an own point wins its own tie.
    keys = (~own, *everything.T[::-1], distance, *voxel.T[::-1])
    order = np.lexsort(keys)
    first = np.ones(len(order), bool)
    first[1:] = np.any(voxel[order][1:] != voxel[order][:-1], axis=1)
    chosen = order[first]
    return np.sort(chosen[chosen < len(points)]).astype(np.int64)
