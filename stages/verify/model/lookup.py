"""A model field as kernels see it: its arrays and the look-ups in them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.compiled import inner
from spinpipe.stages.geometry.model_surface import top_of
from spinpipe.stages.verify.model.field import ModelField

POSE = 7
"""Numbers of a pose: x, y, z of the base centre, yaw, and the stretch along the object's axes."""


class FieldArrays(NamedTuple):
    """The arrays of a ``ModelField``; those of probes in place of their indices."""

    samples: NDArray[np.float64]
    surface: NDArray[np.float64]
    """(S, 8) samples and normals in one row: one look at memory gives both."""
    reach: float
    """Horizontal distance of the outermost sample from the base centre."""
    probes: NDArray[np.float64]
    probe_normals: NDArray[np.float64]
    seen_weight: NDArray[np.float64]
    sides: NDArray[np.float64]
    side_normals: NDArray[np.float64]
    size: NDArray[np.float64]
    top: NDArray[np.float64]
    """(2,) middle of the top, on which a spin image's origin may be."""
    top_half: NDArray[np.float64]
    """(2,) half extents of the top."""
    top_level: float
    """Height of the top, metres."""
    origin: NDArray[np.float64]
    voxel_m: float
    nearest: NDArray[np.int32]
    clearance: NDArray[np.float32]
    footprint: NDArray[np.bool_]
    edges: NDArray[np.float64]
    depth_edge: NDArray[np.int32]
    depths: NDArray[np.float64]
    """Ascending, how far inside the outline the columns' middles lie, metres."""
    outline: NDArray[np.float64]
    outline_normals: NDArray[np.float64]
    outline_height: NDArray[np.float64]


def field_arrays(model: ModelField) -> FieldArrays:
    """What kernels look up of a model."""
    surface = np.zeros((len(model.samples), 8))
    surface[:, :3], surface[:, 3:6] = model.samples, model.normals
    level = model.samples[top_of(model.samples)]
    top = level[:, :2]
    x, y = model.samples[:, 0], model.samples[:, 1]
    return FieldArrays(
        samples=model.samples,
        surface=surface,
        reach=math.sqrt((x**2 + y**2).max()),
        probes=model.samples[model.probes],
        probe_normals=model.normals[model.probes],
        seen_weight=model.seen_weight,
        sides=model.samples[model.side_probes],
        side_normals=model.normals[model.side_probes],
        size=model.size,
        top=(top.min(axis=0) + top.max(axis=0)) / 2,
        top_half=np.ptp(top, axis=0) / 2,
        top_level=float(np.median(level[:, 2])),
        origin=model.origin,
        voxel_m=float(model.voxel_m),
        nearest=model.nearest,
        clearance=model.clearance,
        footprint=model.footprint,
        edges=model.edges,
        depth_edge=model.depth_edge,
        depths=_depths(model),
        outline=model.outline,
        outline_normals=model.outline_normals,
        outline_height=model.outline_height,
    )


def _depths(model: ModelField) -> NDArray[np.float64]:
    nx, ny = model.depth_edge.shape
    x = model.origin[0] + (np.arange(nx)[:, None] + 0.5) * model.voxel_m
    y = model.origin[1] + (np.arange(ny) + 0.5) * model.voxel_m
    px, py, normal_x, normal_y = np.moveaxis(model.edges[model.depth_edge], -1, 0)
    return np.sort((normal_x * (px - x) + normal_y * (py - y)).ravel())


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
def signed_distance(field, pose, c, s, point):
    """How far a point lies above the nearest surface of a posed model, along its normal, metres.

    ``c`` and ``s`` are the cosine and the sine of the pose's yaw; 0 off the grid.
    """
    dx, dy = point[0] - pose[0], point[1] - pose[1]
    ux, uy, uz = c * dx + s * dy, c * dy - s * dx, point[2] - pose[2]
    k = nearest_sample(field, ux / pose[4], uy / pose[5], uz / pose[6])
    if k < 0:
        return 0.0
    near = field.surface[k]
    nx, ny, nz = near[3] / pose[4], near[4] / pose[5], near[5] / pose[6]
    along = nx * (ux - near[0] * pose[4]) + ny * (uy - near[1] * pose[5])
    along += nz * (uz - near[2] * pose[6])
    return along / math.sqrt(nx * nx + ny * ny + nz * nz)
