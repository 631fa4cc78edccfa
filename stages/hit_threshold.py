"""From which correlation an origin is a hit: less where instances are seen by few points."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

MIN_CORRELATION = 0.6
"""Of images of many points [Bovenkamp 2010, section 3.1]."""
FACES_PER_VOXEL = 1.5
"""Mean number of voxels of side v that a surface of area v^2 touches, over all its directions."""


def hit_threshold(expected: Sequence[NDArray[np.float64]]) -> float:
    """Least correlation that shows the least well counted of some models as well as others.

    Parameters
    ----------
    expected : counts of points in the bins of an instance of each model.
    """
    return MIN_CORRELATION * min((counting_loss(counts) for counts in expected), default=1.0)


def counting_loss(expected: NDArray[np.float64]) -> float:
    """Correlation of counts with what is expected of them, 0..1.

    Counts ``c`` of independent points have the variance ``l`` where ``l`` of them are expected, so
    over the bins ``cov(c, l) = var(l)`` and ``var(c) = var(l) + mean(l)``.
    """
    variance = float(np.var(expected))
    return math.sqrt(variance / (variance + float(expected.mean()))) if variance > 0 else 1.0


def points_on(points: NDArray[np.floating], density: float, voxels_along: int = 40) -> float:
    """How many points a cloud has on a surface that (N, 3) points sample densely.

    The area follows from the voxels that they fall into; ``density`` is the cloud's, per square
    metre.
    """
    voxel_m = float(np.ptp(points, axis=0).max()) / voxels_along
    occupied = np.unique(np.floor(points / voxel_m).astype(np.int64), axis=0)
    return len(occupied) * voxel_m**2 / FACES_PER_VOXEL * density
