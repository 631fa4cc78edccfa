"""Colours of any number type, brought to 8 bits."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import U8


def full_colour(chunks: Iterable[NDArray[Any]]) -> float:
    """Value of a channel at full brightness: 1, 255 or 65535.

    Number types do not tell: there are 8-bit colours in LAS's 16-bit fields, and floats both up to
    1 and up to 255. The largest value of the whole file decides; reading stops once it is sure.

    Parameters
    ----------
    chunks : iterable of (N, 3), all of one number type
    """
    brightest = 0.0
    floating = False
    for chunk in chunks:
        if chunk.dtype == np.uint8:
            return 255.0
        floating = chunk.dtype.kind == "f"
        brightest = max(brightest, float(np.nanmax(chunk, initial=0)))
        if brightest > 255:
            return 65535.0
    return 1.0 if floating and brightest <= 1 else 255.0


def to_8_bit(colours: NDArray[Any], full: float) -> U8:
    """Colours (N, 3) with channels 0..``full`` as uint8; what is not a number becomes 0."""
    if colours.dtype == np.uint8:
        return np.ascontiguousarray(colours)
    scaled = np.nan_to_num(colours.astype(np.float32), nan=0.0) * np.float32(255 / full)
    return np.clip(np.rint(scaled), 0, 255).astype(np.uint8)
