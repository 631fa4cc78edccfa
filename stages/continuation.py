"""What stands beyond the sides of a fit: another instance, or the rest of a larger body.

A fit in a row of instances ends where its neighbours begin: the scene need not drop there. A rigid
model that fits into a part of a larger body does not end at all: a surface goes on level with it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Flags = NDArray[np.bool_]

SIDES = ("front", "left", "back", "right")
"""In the order of the evidence: +x, +y, -x and -y of the object."""
GOES_ON = 0.5
"""A body goes on where a surface is level with it along at least this share of a side."""
BEYOND = np.array([0.2, 0.5, 0.9])
"""Where outside a side a neighbour is looked for, in half extents of the narrow side."""
ALONG = np.array([-0.5, 0.0, 0.5])
ROWS = 128
"""Fits looked at together."""


def explained_sides(poses: F64, sizes: F64, near_poses: F64, near_sizes: F64) -> Flags:
    """Whether an instance stands beyond each side of each fit: (S, 4).

    Parameters
    ----------
    poses, sizes : (S, 4) x, y, z of the base centre and yaw; (S, 3) extents, metres.
    near_poses, near_sizes : of the instances. One that stands in the same place is the fit itself.
    """
    found = np.zeros((len(poses), len(SIDES)), bool)
    for first in range(0, len(poses), ROWS):
        rows = slice(first, first + ROWS)
        found[rows] = _explained(poses[rows], sizes[rows], near_poses, near_sizes)
    return found


def first_continuing(levels: F64, explained: Flags) -> list[str]:
    """The first side of each fit where a body goes on that no other instance explains, or "".

    Parameters
    ----------
    levels : (S, 4) share of each side where a level surface goes on.
    explained : (S, 4), see ``explained_sides``.
    """
    goes_on = (levels >= GOES_ON) & ~explained
    return [SIDES[np.argmax(row)] if row.any() else "" for row in goes_on]


def _explained(poses: F64, sizes: F64, near_poses: F64, near_sizes: F64) -> Flags:
    middle = _within(poses[:, None, :2], near_poses, near_sizes)[:, 0]
    swapped = _within(near_poses[:, None, :2], poses, sizes)[:, 0].T
    other = ~(middle | swapped)
    places = _places_beyond(poses, sizes)
    beyond = _within(places.reshape(len(poses), -1, 2), near_poses, near_sizes) & other[:, None]
    covered = beyond.any(axis=2).reshape(len(poses), len(SIDES), len(BEYOND), len(ALONG))
    return np.asarray(2 * covered.any(axis=2).sum(axis=2) >= len(ALONG))


def _places_beyond(poses: F64, sizes: F64) -> F64:
    """Places (S, 4, len(BEYOND), len(ALONG), 2) outside the sides of each fit."""
    half = sizes[:, :2] / 2
    local = np.zeros((len(poses), len(SIDES), len(BEYOND), len(ALONG), 2))
    for side in range(len(SIDES)):
        outwards, along = (0, 1) if side % 2 == 0 else (1, 0)
        reach = half[:, outwards, None] + half.min(axis=1)[:, None] * BEYOND
        local[:, side, :, :, outwards] = (1 if side < 2 else -1) * reach[:, :, None]
        local[:, side, :, :, along] = (half[:, along, None] * ALONG)[:, None]
    cos, sin = np.cos(poses[:, 3]), np.sin(poses[:, 3])
    turn = np.stack([cos, sin, -sin, cos], axis=1).reshape(-1, 2, 2)
    return np.einsum("sabcj,sjk->sabck", local, turn) + poses[:, None, None, None, :2]


def _within(places: F64, poses: F64, sizes: F64) -> Flags:
    """Whether places (S, P, 2) lie in the footprints of N bodies: (S, P, N)."""
    offset = places[:, :, None] - poses[:, :2]
    cos, sin = np.cos(poses[:, 3]), np.sin(poses[:, 3])
    along = np.abs(offset[..., 0] * cos + offset[..., 1] * sin)
    across = np.abs(offset[..., 1] * cos - offset[..., 0] * sin)
    return (along <= sizes[:, 0] / 2) & (across <= sizes[:, 1] / 2)
