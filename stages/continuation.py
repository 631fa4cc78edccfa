"""Whether a body goes on where the model ends, so that the fit may be a part of something larger.

A rigid model fits into a corner of any larger body of its height. There the scene does not drop
beyond a whole side; neither does it where another instance stands close by, which explains it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

SIDES = ("front", "left", "back", "right")
"""In the order of the evidence: +x, +y, -x and -y of the object."""
GOES_ON = 0.25
"""A side goes on where the scene drops by less than this share of the model's height."""
BEYOND = (0.2, 0.5, 0.9)
"""Where outside a side a neighbour explains it, in half extents of the narrow side."""
_ALONG = (-0.5, 0.0, 0.5)


def continuing_sides(poses: F64, sizes: F64, drops: F64, accepted: NDArray[np.bool_]) -> list[str]:
    """The first side of each fit that goes on without another instance there, or "".

    Parameters
    ----------
    poses : (S, 4) x, y, z of the base centre and yaw.
    sizes : (S, 3) fitted extents, metres.
    drops : (S, 4) drop of the scene at each side, 0..1.
    accepted : (S,) which fits are instances as far as is known: only they explain others.
    """
    found: list[str] = []
    neighbours = np.flatnonzero(accepted)
    for row in range(len(poses)):
        others = neighbours[neighbours != row]
        name = ""
        for side in np.flatnonzero(drops[row] < GOES_ON):
            explained = [
                _covered(places, poses[others], sizes[others])
                for places in _places_beyond(poses[row], sizes[row], int(side))
            ]
            if 2 * np.any(explained, axis=0).sum() < len(_ALONG):
                name = SIDES[side]
                break
        found.append(name)
    return found


def _places_beyond(pose: F64, size: F64, side: int) -> Iterator[F64]:
    """Places (3, 2) along a side, ever farther outside it."""
    half = size[:2] / 2
    outwards, along = (0, 1) if side % 2 == 0 else (1, 0)
    cos, sin = np.cos(pose[3]), np.sin(pose[3])
    for share in BEYOND:
        local = np.zeros((len(_ALONG), 2))
        local[:, outwards] = half[outwards] + share * half.min()
        local[:, outwards] *= 1 if side < 2 else -1
        local[:, along] = np.array(_ALONG) * half[along]
        yield local @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]


def _covered(places: F64, poses: F64, sizes: F64) -> NDArray[np.bool_]:
    """(P,) whether each place lies in the footprint of any of some bodies."""
    offset = places[:, None] - poses[None, :, :2]
    cos, sin = np.cos(poses[:, 3]), np.sin(poses[:, 3])
    along = np.abs(offset[..., 0] * cos + offset[..., 1] * sin)
    across = np.abs(offset[..., 1] * cos - offset[..., 0] * sin)
    inside = (along <= sizes[:, 0] / 2) & (across <= sizes[:, 1] / 2)
    return np.asarray(inside.any(axis=1))
