"""From which correlation an origin is a hit: less where instances are seen by few points."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from spinpipe.schemas.arrays import F64

MIN_CORRELATION = 0.6
"""Of images of many points [Bovenkamp 2010, section 3.1]."""


def hit_threshold(expected: Sequence[F64]) -> float:
    """Least correlation that shows the least well counted of some models as well as others.

    Parameters
    ----------
    expected : counts of points in the bins of an instance of each model.
    """
    return MIN_CORRELATION * min((counting_loss(counts) for counts in expected), default=1.0)


def counting_loss(expected: F64) -> float:
    """Correlation of counts with what is expected of them, 0..1.

    Counts ``c`` of independent points have the variance ``l`` where ``l`` of them are expected, so
    over the bins ``cov(c, l) = var(l)`` and ``var(c) = var(l) + mean(l)``.
    """
    variance = float(np.var(expected))
    return math.sqrt(variance / (variance + float(expected.mean()))) if variance > 0 else 1.0
