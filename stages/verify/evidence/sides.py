"""Evidence of the model's upright surfaces; compiled, see ``evidence``."""

from __future__ import annotations

import math

from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.evidence.scene import side_of
from spinpipe.stages.verify.evidence.surface import depth_at, enough_for_a_surface
from spinpipe.stages.verify.model.lookup import signed_distance
from spinpipe.stages.verify.model.pose import to_scene
from spinpipe.stages.verify.scene.cell_grid import points_of, window

LOW = 0.1
"""Height, as a share of the model's, up to which points beside it may be the ground's."""
STANDING_POINTS = 4
"""Least points beside it that make a surface."""


@inner
def side_evidence(grid, field, pose, gate, sharp, free):
    """Share of the model's upright surface that the scene supports and that it contradicts.

    Whether upright surfaces are seen at all depends on where the sensor was. So nothing follows
    from one that is not there, unless points below it show that its place was looked through, or a
    surface stands beside it. Arguments as of ``surface_evidence``; ``free`` as of
    ``scene_evidence``.

    Returns
    -------
    supported, contradicted : shares of the upright surface.
    """
    points, probes, normals, column_m = grid.points, field.sides, field.side_normals, grid.cell_m
    reach = max(gate, column_m)
    enough = enough_for_a_surface(grid)
    supported = 0.0
    contradicted = 0.0
    low = LOW * field.size[2] * pose.stretch_z
    for k in range(probes.shape[0]):
        x, y = to_scene(pose, probes[k, 0] * pose.stretch_x, probes[k, 1] * pose.stretch_y)
        z = pose.z + probes[k, 2] * pose.stretch_z
        at = 0
        below = 0
        above = 0
        standing = 0
        offset = 0.0
        cells = window(grid, x, y, reach)
        for i in range(cells.first, cells.past):
            for n in points_of(grid, cells, i):
                dx, dy, dz = points[n, 0] - x, points[n, 1] - y, points[n, 2] - z
                flat2 = dx * dx + dy * dy
                if flat2 + dz * dz <= reach * reach:
                    at += 1
                    if points[n, 2] - pose.z > low:
                        standing += 1
                        offset += signed_distance(field, pose, points[n])
                elif flat2 <= column_m * column_m:
                    if dz > 0.0:
                        above += 1
                    elif depth_at(field, pose, points[n, 0], points[n, 1]) > sharp:
                        below += 1
        if at > 0:
            side = side_of(normals[k, 0], normals[k, 1], abs(normals[k, 0]), abs(normals[k, 1]))
            if free[side] and standing >= STANDING_POINTS:
                # a mean of several points, so known better than one
                near = math.sqrt(sharp * sharp + (gate * gate - sharp * sharp) / standing)
                if abs(offset / standing) > near:
                    contradicted += 1.0
                    continue
            supported += 1.0
        elif below > 0 and above == 0:
            contradicted += min(1.0, below / enough)
    count = max(probes.shape[0], 1)
    return supported / count, contradicted / count
