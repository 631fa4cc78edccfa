"""Evidence of the place just outside the model's outline; compiled, see ``evidence``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.evidence.scene import side_of
from spinpipe.stages.verify.model.pose import to_scene
from spinpipe.stages.verify.scene.cell_grid import points_of, window

COLUMN_CELLS = 0.7
"""Radius of the column looked at, in cells."""
TOUCHED = 0.5
"""Something else touches a side, or the body goes on, where the scene drops by a smaller share."""
LEVEL = 0.1
"""The scene goes on beyond the outline where its height differs by less than this share, or the
gate."""
TALL_SHARE = 0.25
"""What ends lower, as a share of the model's height, is level with the ground too easily."""
FAR = 0.5
"""How far from the outline what the object stands on is looked for, in half widths: chosen."""
DEEP = 0.2
"""How far below the base, as a share of the height, the scene shows that nothing stands there."""
GOES_ON = 0.5
"""A body goes on where a surface is level with it along at least this share of a side."""
SIDES = ("front", "left", "back", "right")
"""In the order of the evidence: +x, +y, -x and -y of the object."""


class Outline(NamedTuple):
    """How far the scene drops outside the outline, 0..1, and on how much of it it goes on.

    ``ring`` is how much of the outline was observed, ``grounded`` on how much of it, where the
    scene drops at all, it drops to the base and no deeper; ``front`` to ``right`` are the drops at
    the sides, ``front_level`` to ``right_level`` the shares of them where it goes on.
    """

    drop: float
    ring: float
    grounded: float
    front: float
    left: float
    back: float
    right: float
    front_level: float
    left_level: float
    back_level: float
    right_level: float


class Column(NamedTuple):
    """What a column of the scene shows below a ceiling, and the lowest point above that."""

    seen: int
    """Number of points."""
    level: float
    """Upper quartile of the heights: where the scene shows ground below things, things go on."""
    top: float
    """Upper decile."""
    overhead: float


@inner
def _column(grid, x, y, radius_m, base, ceiling):
    """Heights above ``base`` in a column."""
    cells = window(grid, x, y, radius_m)
    total = 0
    for i in range(cells.first, cells.past):
        total += len(points_of(grid, cells, i))
    heights = np.empty(total)
    count = 0
    overhead = np.inf
    for i in range(cells.first, cells.past):
        for n in points_of(grid, cells, i):
            dx, dy = grid.points[n, 0] - x, grid.points[n, 1] - y
            if dx * dx + dy * dy > radius_m * radius_m:
                continue
            z = grid.points[n, 2] - base
            if z > ceiling:
                overhead = min(overhead, z)
            else:
                heights[count] = z
                count += 1
    if count == 0:
        return Column(0, 0.0, 0.0, overhead)
    ascending = np.sort(heights[:count])
    return Column(count, ascending[(3 * count) // 4], ascending[(9 * count) // 10], overhead)


@inner
def outline_evidence(grid, field, pose, gate):
    """How far the scene drops just outside the model's outline.

    A body ends where the model ends; a wall, a hedge or a roof that only contains the model's
    shape goes on. What stands on something is surrounded by that; a crown or a ridge that looks
    like the model from above falls on past where its base would be.

    Parameters
    ----------
    grid : CellGrid, ground included.
    field : ModelField.
    pose : Pose.
    gate : how far outside to look, apart from the radius of the column, metres.

    Returns
    -------
    Outline
        Drops are means over the observed outline of each side of (model height inside - scene
        height outside) / model height; a side hardly observed counts as 1. In the mean over the
        sides each counts by how much of it was observed, whatever its length: the ends alone tell
        where along its axis a long object stands. The scene goes on where a surface outside is
        level with the one inside.
    """
    outline, normals = field.outline, field.outline_normals
    column_m = COLUMN_CELLS * grid.cell_m
    beyond_m = gate + column_m
    apart_m = (
        beyond_m + FAR * min(field.size[0] * pose.stretch_x, field.size[1] * pose.stretch_y) / 2
    )
    height = field.size[2] * pose.stretch_z
    deep_m = max(gate, DEEP * height)
    drops = np.zeros(len(SIDES))
    levels = np.zeros(len(SIDES))
    observed = np.zeros(len(SIDES))
    whole = np.zeros(len(SIDES))
    at_base = 0
    deeper = 0
    tall = field.outline_height > TALL_SHARE * field.size[2]
    for k in range(outline.shape[0]):
        mx, my = outline[k, 0] * pose.stretch_x, outline[k, 1] * pose.stretch_y
        x, y = to_scene(pose, mx + normals[k, 0] * apart_m, my + normals[k, 1] * apart_m)
        around = _column(grid, x, y, column_m, pose.z, height)
        if around.seen > 0 and around.level <= deep_m:
            if around.level >= -deep_m:
                at_base += 1
            else:
                deeper += 1
        side = side_of(normals[k, 0], normals[k, 1], abs(normals[k, 0]), abs(normals[k, 1]))
        whole[side] += 1.0
        inner_height = field.outline_height[k] * pose.stretch_z
        x, y = to_scene(pose, mx + normals[k, 0] * beyond_m, my + normals[k, 1] * beyond_m)
        beside = _column(grid, x, y, column_m, pose.z, inner_height + beyond_m)
        if beside.seen > 0:
            drop = min(max((inner_height - beside.level) / inner_height, 0.0), 1.0)
            drops[side] += drop
            level_with = abs(inner_height - beside.top) <= max(gate, LEVEL * inner_height)
            if level_with and tall[k] and drop < TOUCHED and beside.overhead > 2 * inner_height:
                levels[side] += 1.0
        elif beside.overhead > 2 * inner_height:
            continue  # nothing seen, or a crown or a roof that hides what is below it
        observed[side] += 1.0
    grounded = at_base / (at_base + deeper) if at_base + deeper > 0 else 1.0
    seen = observed.sum()
    if seen == 0.0:
        return Outline(0.0, 0.0, grounded, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    share = np.ones(len(SIDES))
    level_share = np.zeros(len(SIDES))
    drop, weight = 0.0, 0.0
    for side in range(len(SIDES)):
        drop += drops[side] / max(whole[side], 1.0)
        weight += observed[side] / max(whole[side], 1.0)
        if observed[side] >= max(0.5 * whole[side], 1.0):
            share[side] = drops[side] / observed[side]
            level_share[side] = levels[side] / whole[side]
    return Outline(
        drop / weight, seen / outline.shape[0], grounded,
        share[0], share[1], share[2], share[3],
        level_share[0], level_share[1], level_share[2], level_share[3],
    )  # fmt: skip
