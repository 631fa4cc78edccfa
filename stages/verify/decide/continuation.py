"""What stands beyond the sides of a fit: another instance, or the rest of a larger body.

A fit in a row of instances ends where its neighbours begin: the scene need not drop there. A rigid
model that fits into a part of a larger body does not end at all: a surface goes on level with it.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F64, I64, Mask
from spinpipe.stages.geometry.frames import turns
from spinpipe.stages.verify.evidence.outline import GOES_ON, SIDES

BEYOND = np.array([0.2, 0.5, 0.9])
"""Where outside a side a neighbour is looked for, in half extents of the narrow side or in
``BRIDGED`` heights, whichever is more."""
BRIDGED = 0.6
"""Gap between bodies, in heights, that photos from above hardly see into: chosen, its bottom is
seen from within 30 degrees of straight above only."""
ALONG = np.array([-0.5, 0.0, 0.5])
INTERIOR = np.stack(np.meshgrid([-0.8, -0.4, 0.0, 0.4, 0.8], [-0.8, -0.4, 0.0, 0.4, 0.8]), -1)
"""Places in a body, in half extents."""
FARTHER = 0.1
"""A fit that stands so far beyond a side, in extents, is not the same one: chosen."""
SHARED = 1 / 3
"""Share of the body that it must have in common to be no neighbour: chosen; moved by half of the
body it shares half."""
COMMON = 0.15
"""Share of either body's interior that neighbours may have in common; rivals have more."""


def explained_sides(poses: F64, sizes: F64, near_poses: F64, near_sizes: F64) -> Mask:
    """Whether an instance stands beyond each side of each fit: (S, 4).

    Parameters
    ----------
    poses, sizes : (S, 4) x, y, z of the base centre and yaw; (S, 3) extents, metres.
    near_poses, near_sizes : of the instances. One that stands in the fit's place, in whole or in
        part, is a rival or the fit itself: it explains nothing.
    """
    covered = np.zeros((len(poses), len(SIDES), len(BEYOND), len(ALONG)), bool)
    if len(poses) and len(near_poses):
        fit, near = _pairs_within_reach(poses, sizes, near_poses, near_sizes)
        pair, other_pair = (poses[fit], sizes[fit]), (near_poses[near], near_sizes[near])
        common = np.maximum(
            _within(_interior(*pair), *other_pair).mean(axis=(1, 2)),
            _within(_interior(*other_pair), *pair).mean(axis=(1, 2)),
        )
        beyond = _within(_places_beyond(*pair), *other_pair)
        beyond &= (common <= COMMON)[:, None, None, None]
        np.logical_or.at(covered, fit, beyond)
    return np.asarray(2 * covered.any(axis=2).sum(axis=2) >= len(ALONG))


def fits_farther_on(pose: F64, size: F64, others: F64) -> Mask:
    """Whether the model fits beyond each side of a fit, in part where it already fits: (4,).

    Parameters
    ----------
    pose, size : (4,) x, y, z of the base centre and yaw; (3,) extents, metres.
    others : (R, 4) other fits of the same model that are as good as instances.
    """
    moved = (others[:, :2] - pose[:2]) @ turns(pose[3]) / size[:2]
    shared = np.prod(np.clip(1.0 - np.abs(moved), 0.0, None), axis=1) >= SHARED
    onward = np.concatenate([moved, -moved], axis=1)
    return np.asarray((shared[:, None] & (onward > FARTHER)).any(axis=0))


def first_continuing(levels: F64, explained: Mask, farther: Mask) -> list[str]:
    """The first side of each fit where a body goes on that no other instance explains, or "".

    Parameters
    ----------
    levels : (S, 4) share of each side where a level surface goes on.
    explained : (S, 4), see ``explained_sides``.
    farther : (S, 4), see ``fits_farther_on``: what only touches an instance is another body.
    """
    goes_on = (levels >= GOES_ON) & ~explained & farther
    return [SIDES[np.argmax(row)] if row.any() else "" for row in goes_on]


def _pairs_within_reach(
    poses: F64, sizes: F64, near_poses: F64, near_sizes: F64
) -> tuple[I64, I64]:
    """Rows of fits and of the instances that may lie beyond their sides, pair by pair."""
    reach = np.hypot(sizes[:, 0], sizes[:, 1]) / 2 + BEYOND.max() * _apart(sizes)
    reach += np.hypot(near_sizes[:, 0], near_sizes[:, 1]).max() / 2
    found = KDTree(near_poses[:, :2]).query_ball_point(poses[:, :2], reach, return_sorted=True)
    fit = np.repeat(np.arange(len(poses)), [len(rows) for rows in found])
    return fit, np.concatenate([np.asarray(rows, np.int64) for rows in found])


def _apart(sizes: F64) -> F64:
    """(S,) how far beyond a side a neighbour may begin, metres."""
    return np.maximum(sizes[:, :2].min(axis=1) / 2, BRIDGED * sizes[:, 2])


def _places_beyond(poses: F64, sizes: F64) -> F64:
    """Places (S, 4, len(BEYOND), len(ALONG), 2) outside the sides of each fit."""
    half = sizes[:, :2] / 2
    local = np.zeros((len(poses), len(SIDES), len(BEYOND), len(ALONG), 2))
    for side in range(len(SIDES)):
        outwards, along = (0, 1) if side % 2 == 0 else (1, 0)
        reach = half[:, outwards, None] + _apart(sizes)[:, None] * BEYOND
        local[:, side, :, :, outwards] = (1 if side < 2 else -1) * reach[:, :, None]
        local[:, side, :, :, along] = (half[:, along, None] * ALONG)[:, None]
    return np.einsum("sabcj,skj->sabck", local, turns(poses[:, 3])) + poses[:, None, None, None, :2]


def _interior(poses: F64, sizes: F64) -> F64:
    """Places (S, 5, 5, 2) in each fit."""
    local = INTERIOR * sizes[:, None, None, :2] / 2
    return np.einsum("sabj,skj->sabk", local, turns(poses[:, 3])) + poses[:, None, None, :2]


def _within(places: F64, poses: F64, sizes: F64) -> Mask:
    """Whether places (Q, ..., 2) lie in the footprints of Q bodies, each in its own."""
    wide = (len(poses), *(1,) * (places.ndim - 2))
    x, y, yaw, length, width = (
        column.reshape(wide) for column in (*poses[:, [0, 1, 3]].T, *sizes[:, :2].T)
    )
    dx, dy = places[..., 0] - x, places[..., 1] - y
    along = np.abs(dx * np.cos(yaw) + dy * np.sin(yaw))
    across = np.abs(dy * np.cos(yaw) - dx * np.sin(yaw))
    return (along <= length / 2) & (across <= width / 2)
