"""The height of the ground along a stated up direction."""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.arrays import F64

COLUMN_VOXELS = 4.0
"""Edge of the columns whose lowest points are the ground, in voxels of the sample."""
NOTABLE = 0.25
"""A level is ground if it holds this share of the columns that the most common level holds."""


def lowest_level(points: F64, up: F64, voxel: float, distance: float) -> float:
    """Height of the ground: the lowest level on which many columns of the scene end.

    Each vertical column gives its second lowest sample point, so that single points below the
    surface count for nothing. Levels that hold few columns (pits, stray groups) are passed over.

    Parameters
    ----------
    points
        (N, 3) sample, uniform in area.
    up
        (3,) unit vector.
    voxel
        Spacing of the sample.
    distance
        Inlier distance of the ground: levels are counted in windows of twice that.

    Returns
    -------
    float
        ``dot(up, p)`` of the ground.
    """
    heights = points @ up
    axes = np.linalg.svd(up[None])[2][1:]
    columns = np.floor(points @ axes.T / (COLUMN_VOXELS * voxel)).astype(np.int64)
    _, column = np.unique(columns, axis=0, return_inverse=True)
    order = np.lexsort((heights, column.ravel()))
    column, heights = column.ravel()[order], heights[order]
    first = np.flatnonzero(np.diff(column, prepend=-1))
    second = np.minimum(first + 1, len(column) - 1)
    lows = np.sort(heights[np.where(column[second] == column[first], second, first)])
    # A tilted ground spreads over more than its noise: windows hold a fair share of the columns.
    spread = np.quantile(lows, 0.75) - np.quantile(lows, 0.25)
    half = max(distance, float(spread) / 10)
    held = np.searchsorted(lows, lows + half, "right") - np.searchsorted(lows, lows - half)
    lowest = int(np.flatnonzero(held >= NOTABLE * held.max())[0])
    level = lows[lowest]
    for _ in range(20):  # mean shift to the top of that level [Comaniciu & Meer 2002]
        window = lows[np.abs(lows - level) <= half]
        moved, level = level, float(np.median(window))
        if level == moved:
            break
    return level
