"""Plain, slow twins of look-ups and of the points around a candidate.

All twins here are the kernels' formulas over whole arrays, without walks over grids. Sums run from
the first point to the last as the kernels' do, so results may be compared closely.
"""

from __future__ import annotations

import math

import numpy as np

from spinpipe.stages.verify.judge.kernels import FINE_POINTS
from spinpipe.stages.verify.scene.candidate_points import GROUND_POINTS, Points


def total(values):
    """Sum from the first value to the last."""
    return float(np.add.accumulate(values)[-1]) if len(values) else 0.0


def to_object(pose, points):
    """(N, 3) points in the object's axes, not unstretched."""
    (dx, dy, dz), c, s = (points - pose[:3]).T, math.cos(pose[3]), math.sin(pose[3])
    return np.column_stack([c * dx + s * dy, c * dy - s * dx, dz])


def to_scene(pose, xy):
    """(N, 2) scene from places in the object's axes, stretched already."""
    c, s = math.cos(pose[3]), math.sin(pose[3])
    return np.column_stack(
        [pose[0] + c * xy[:, 0] - s * xy[:, 1], pose[1] + s * xy[:, 0] + c * xy[:, 1]]
    )


def look_up(table, field, u):
    """Values of a table over the field's voxels or columns at points (N, 2 or 3), -1 off it."""
    cell = np.floor((u - field.origin[: u.shape[1]]) * (1.0 / field.voxel_m)).astype(int)
    inside = ((cell >= 0) & (cell < table.shape)).all(axis=1)
    found = np.full(len(u), -1)
    found[inside] = table[tuple(cell[inside].T)]
    return found


def depths(field, u):
    """(N,) how far inside the nearest edge of the outline places (N, 2) lie; -inf off the grid."""
    e = look_up(field.depth_edge, field, u)
    depth = (field.edges[e, 2:] * (field.edges[e, :2] - u)).sum(axis=1)
    return np.where(e < 0, -np.inf, depth)


def off_surface(field, pose, u):
    """Nearest sample of points (N, 3) in the object's axes, offset from it, unit normal there."""
    k = look_up(field.nearest, field, u / pose[4:])
    normal = field.surface[k, 3:6] / pose[4:]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return k, u - pose[4:] * field.surface[k, :3], normal


def column(scene, xy, radius):
    """Rows of the points in a column."""
    dx, dy = scene.points[:, 0] - xy[0], scene.points[:, 1] - xy[1]
    return np.flatnonzero(dx * dx + dy * dy <= radius * radius)


def side_of(x, y, out_x, out_y):
    """Number of the side beyond which a point lies farther."""
    return np.where(out_x >= out_y, np.where(x > 0, 0, 2), np.where(y > 0, 1, 3))


def cut_out(scene, xy, radius, low, ceiling, count):
    """See ``candidate_points.cut_out``."""
    dx, dy = scene.points[:, 0] - xy[0], scene.points[:, 1] - xy[1]
    near = dx * dx + dy * dy < radius * radius
    z = scene.points[:, 2]
    ground = np.flatnonzero(near & (np.abs(z) <= low))
    body = np.flatnonzero(near & (z > low) & (z < ceiling))
    cut = []
    for rows, most in ((body, count), (ground, GROUND_POINTS)):
        stride = max(1, -(-len(rows) // most))
        rows = rows[::stride]
        cut.append(Points(scene.points[rows], scene.weights[rows] * stride))
    return cut


def fine_points(scene, field, limits, start):
    """What a pose is refined with."""
    half_diagonal = math.hypot(field.size[0], field.size[1]) / 2
    reach = half_diagonal * (1 + limits.stretch) + 2 * limits.coarse_gate_m
    ceiling = start[2] + field.size[2] * (1 + 2 * limits.stretch) + 2 * limits.coarse_gate_m
    return cut_out(scene, start[:2], reach, limits.low_m, ceiling, FINE_POINTS)
