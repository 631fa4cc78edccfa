"""Numbers as colours: viridis, which everyone can read and which prints well in grey."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import U8

# Every 32nd entry of matplotlib's viridis (CC0), between which the colours are interpolated.
_VIRIDIS = np.array(
    [
        (68, 1, 84),
        (71, 44, 122),
        (59, 81, 139),
        (44, 113, 142),
        (33, 144, 141),
        (39, 173, 129),
        (92, 200, 99),
        (170, 220, 50),
        (253, 231, 37),
    ],
    dtype=np.float64,
)


def viridis(values: NDArray[Any], low: float = 0.0, high: float = 1.0) -> U8:
    """(N,) numbers -> (N, 3) colours; beyond ``low`` and ``high`` the end colours, NaN is low."""
    position = np.nan_to_num((np.asarray(values, np.float64) - low) / (high - low), nan=0.0)
    stops = np.linspace(0.0, 1.0, len(_VIRIDIS))
    channels = [np.interp(position, stops, _VIRIDIS[:, c]) for c in range(3)]
    return np.stack(channels, axis=-1).round().astype(np.uint8)
