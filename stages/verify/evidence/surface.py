"""Evidence of the model's surface that is visible from above; compiled, see ``evidence``."""

from __future__ import annotations

import math
from typing import NamedTuple

from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.model.lookup import inside_depth, signed_distance
from spinpipe.stages.verify.model.pose import to_object, to_scene
from spinpipe.stages.verify.scene.cell_grid import points_of, window


class Surface(NamedTuple):
    """Shares of the visible area: the first four together 1; ``sheltered`` is below another one."""

    supported: float
    contradicted: float
    empty: float
    covered: float
    sheltered: float


@inner
def enough_for_a_surface(grid):
    """Points in a column, a quarter of those around: enough to be a surface of its own right."""
    return max(0.25 * grid.density * math.pi * grid.cell_m * grid.cell_m, 1.0)


@inner
def depth_at(field, pose, x, y):
    """How far inside the outline of the model at a pose a place of the scene lies, metres."""
    ux, uy, _ = to_object(pose, x, y, 0.0)
    return inside_depth(field, ux / pose.stretch_x, uy / pose.stretch_y)


@inner
def surface_evidence(grid, field, pose, gate, sharp):
    """Share of the model's visible area that the scene supports and that it contradicts.

    In a column of one cell's radius around each probe.

    Parameters
    ----------
    grid : CellGrid, ground included.
    field : ModelField.
    pose : Pose.
    gate : how far a point may lie from the model's surface, noise included, metres.
    sharp : how far the surface itself may lie from it, metres: the mean of n points may lie
        sqrt(sharp^2 + (gate^2 - sharp^2) / n) away.

    Returns
    -------
    Surface
    """
    points, samples, normals, seen_weight = (
        grid.points, field.probes, field.probe_normals, field.seen_weight
    )  # fmt: skip
    supported = 0.0
    contradicted = 0.0
    empty = 0.0
    sheltered = 0.0
    column_m = grid.cell_m
    enough = enough_for_a_surface(grid)
    radius2 = column_m * column_m
    for k in range(samples.shape[0]):
        if seen_weight[k] <= 0.0:
            continue
        x, y = to_scene(pose, samples[k, 0] * pose.stretch_x, samples[k, 1] * pose.stretch_y)
        z = pose.z + samples[k, 2] * pose.stretch_z
        # on a slope the surface within the column spans more height
        nz = max(normals[k, 2], 0.3)
        slope = math.sqrt(1.0 - nz * nz) / nz
        band = gate / nz
        at = 0
        below = 0
        offset = 0.0
        above = 0
        cells = window(grid, x, y, column_m)
        for i in range(cells.first, cells.past):
            for n in points_of(grid, cells, i):
                dx, dy = points[n, 0] - x, points[n, 1] - y
                if dx * dx + dy * dy > radius2:
                    continue
                dz = points[n, 2] - z
                if abs(dz) <= band + 0.5 * slope * column_m:
                    at += 1
                    offset += signed_distance(field, pose, points[n])
                elif dz < 0.0:
                    # what lies beside the body is no sight through it
                    if depth_at(field, pose, points[n, 0], points[n, 1]) > 0.5 * sharp:
                        below += 1
                else:
                    above += 1
        if above >= enough:  # fewer are stray
            sheltered += seen_weight[k]
        if at > 0:
            held = max(min(at / enough, 1.0), at / (at + below))
            surface = math.sqrt(sharp * sharp + (gate * gate - sharp * sharp) / at)
            if abs(offset / at) > surface:
                # a surface, but not this one
                contradicted += seen_weight[k]
                continue
        else:
            held = 0.0
        supported += seen_weight[k] * held
        if at + below + above == 0:
            empty += seen_weight[k]
        elif below > 0 and above < enough:
            contradicted += seen_weight[k] * (1.0 - held) * min(1.0, below / enough)
    covered = max(0.0, 1.0 - supported - contradicted - empty)
    return Surface(supported, contradicted, empty, covered, sheltered)
