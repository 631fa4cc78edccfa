"""Non-maximum suppression: the best hit stands for all hits near it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import I64


def suppress(
    points: NDArray[np.floating], correlation: NDArray[np.floating], radius_m: float
) -> tuple[I64, I64]:
    """Keep hits that no better hit is near to.

    Hits are taken from the best downwards; each one not yet claimed becomes a peak and claims all
    unclaimed hits within ``radius_m`` horizontally. Equal correlations are taken in the order of
    their coordinates, so the order of the input does not matter.

    Parameters
    ----------
    points : (N, 3)
        World, metres.
    correlation : (N,)
    radius_m : float
        Horizontal reach of a peak.

    Returns
    -------
    peaks : (P,) int64
        Rows of the peaks, best first.
    members : (N,) int64
        For every hit the number of the peak that claimed it.
    """
    members = np.full(len(points), -1, np.int64)
    peaks: list[int] = []
    if len(points) == 0:
        return np.empty(0, np.int64), members
    xy = points[:, :2].astype(np.float64)
    tree = KDTree(xy)
    for row in np.lexsort((*points.T[::-1], -correlation)):
        if members[row] >= 0:
            continue
        near = np.asarray(tree.query_ball_point(xy[row], radius_m), np.int64)
        members[near[members[near] < 0]] = len(peaks)
        peaks.append(int(row))
    return np.array(peaks, np.int64), members
