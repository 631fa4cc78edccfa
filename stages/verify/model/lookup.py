"""Look-ups of kernels in a ``ModelField``."""

from __future__ import annotations

import math

import numpy as np

from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.model.pose import to_object


@inner
def half_diagonal(field):
    """Half of the horizontal diagonal of the model, metres."""
    return math.hypot(field.size[0], field.size[1]) / 2


@inner
def nearest_sample(field, ux, uy, uz):
    """Index of the sample nearest to a point of the unstretched object frame, -1 off the grid."""
    origin, inv, nearest = field.origin, 1.0 / field.voxel_m, field.nearest
    i = int(math.floor((ux - origin[0]) * inv))
    j = int(math.floor((uy - origin[1]) * inv))
    k = int(math.floor((uz - origin[2]) * inv))
    if i < 0 or j < 0 or k < 0:
        return -1
    if i >= nearest.shape[0] or j >= nearest.shape[1] or k >= nearest.shape[2]:
        return -1
    return nearest[i, j, k]


@inner
def nearest_edge(field, ux, uy):
    """Index of the edge nearest to a point of the unstretched object frame, -1 off the grid."""
    origin, inv, depth_edge = field.origin, 1.0 / field.voxel_m, field.depth_edge
    i = int(math.floor((ux - origin[0]) * inv))
    j = int(math.floor((uy - origin[1]) * inv))
    if i < 0 or j < 0 or i >= depth_edge.shape[0] or j >= depth_edge.shape[1]:
        return -1
    return depth_edge[i, j]


@inner
def inside_depth(field, ux, uy):
    """How far inside the outline a point of the unstretched object frame lies, metres.

    Negative outside; -inf off the grid.
    """
    e = nearest_edge(field, ux, uy)
    if e < 0:
        return -np.inf
    edges = field.edges
    return edges[e, 2] * (edges[e, 0] - ux) + edges[e, 3] * (edges[e, 1] - uy)


@inner
def signed_distance(field, pose, point):
    """How far a point lies above the nearest surface of a posed model, along its normal, metres.

    0 off the grid.
    """
    sx, sy, sz = pose.stretch_x, pose.stretch_y, pose.stretch_z
    ux, uy, uz = to_object(pose, point[0], point[1], point[2])
    k = nearest_sample(field, ux / sx, uy / sy, uz / sz)
    if k < 0:
        return 0.0
    near = field.surface[k]
    nx, ny, nz = near[3] / sx, near[4] / sy, near[5] / sz
    along = nx * (ux - near[0] * sx) + ny * (uy - near[1] * sy)
    along += nz * (uz - near[2] * sz)
    return along / math.sqrt(nx * nx + ny * ny + nz * nz)
