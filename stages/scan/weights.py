"""Weights of spin image bins: what lies outside the model's own extent may count less.

What stands beside an instance falls into bins that the model itself cannot reach. With weights
below 1 there, the correlation is masked: neighbours disturb it less, and so does what would tell
the object from a larger one that contains its shape.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MARGIN_BINS = 1
"""Bins beyond the model's farthest point that still belong to it: noise carries points there."""


def extent_weights(values: NDArray[np.floating], outside: float) -> NDArray[np.float64]:
    """Weights 1 within the model's extent at each depth and ``outside`` beyond it.

    Parameters
    ----------
    values : (rows, cols) array
        The model's spin image: points counted by depth and distance.
    outside : float
        0 masks the bins beyond the extent, 1 treats all bins alike.

    Returns
    -------
    (rows, cols) float64 array
    """
    columns = np.arange(values.shape[1])
    occupied = values > 0
    farthest = np.where(occupied, columns, -1 - MARGIN_BINS).max(axis=1, keepdims=True)
    return np.where(columns <= farthest + MARGIN_BINS, 1.0, outside)
