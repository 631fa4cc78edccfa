"""Coordinates and colours out of structured rows, as PCD files and point cloud messages hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F64, U8
from spinpipe.stages.ingest.colour_range import full_colour, to_8_bit
from spinpipe.stages.ingest.scene_source import white

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
