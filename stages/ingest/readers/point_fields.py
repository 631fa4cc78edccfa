"""Coordinates and colours out of the fields that files hold them in, whatever their number type."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F64, U8
from spinpipe.stages.ingest.readers.scene_source import white

CHANNELS = ("red", "green", "blue")


def xyz_of(rows: NDArray[Any]) -> F64:
    """Fields x, y and z of structured rows, (N, 3)."""
    xyz = np.empty((len(rows), 3))
    for column, axis in enumerate("xyz"):
        xyz[:, column] = rows[axis]
    return xyz


def colours_of(rows: NDArray[Any]) -> U8:
    """Colours (N, 3): PCL's ``rgb`` packs 0xRRGGBB into a number, Foxglove has three fields."""
    names = rows.dtype.names or ()
    packed = next((name for name in ("rgb", "rgba") if name in names), None)
    if packed is not None and rows.dtype[packed].itemsize == 4:
        bits = np.ascontiguousarray(rows[packed])
        bits = bits.view(np.uint32) if bits.dtype.kind == "f" else bits.astype(np.uint32)
        return np.stack([(bits >> shift) & 255 for shift in (16, 8, 0)], axis=1).astype(np.uint8)
    if set(CHANNELS) <= set(names):
        colours = np.stack([rows[name] for name in CHANNELS], axis=1)
        return to_8_bit(colours, full_colour([colours]))
    return white(len(rows))


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
