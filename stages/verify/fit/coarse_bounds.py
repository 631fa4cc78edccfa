"""What ``coarse_fit`` can be at most, for all poses of a coarse search at once; compiled.

The clearance of a voxel bounds the residual of every point in it, so two look-ups a point that LLVM
vectorises bound the gain from above. Offsets are made in the object frame: a heading's points are
turned once, and an offset shifts their columns. In float32; no bound is lower than the gain that
``coarse_fit`` computes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from spinpipe.schemas.arrays import U32
from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.model.field import ModelField

ROUNDING = 1.0001
"""Above the rounding of float32 sums over a few hundred points."""
LONG_TOP = 1.5
"""Half length of a top, in half widths, from which a candidate may lie anywhere on it: chosen."""
DOUBT = 2e-3
"""Voxels from a border within which float32 may err about the column of a point."""

reordered = njit(
    nogil=True,
    error_model="numpy",
    fastmath={"reassoc", "nsz", "nnan", "ninf", "contract"},
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
)
"""Compiles sums whose order does not matter."""


class Columns(NamedTuple):
    """Points at all offsets along one axis: (offsets, N) parts of a voxel's number."""

    body: U32
    ground: U32


@inner
def gain(explained, unexplained, enough):
    """How convincing a pose is, 0..1; see ``coarse_fit``."""
    if explained <= 0.0:
        return 0.0
    return explained / (explained + unexplained) * explained / (explained + enough)


@inner
def offset_steps(field, limits):
    """Steps along the object's x and y by which a candidate may lie off the middle of its top.

    A long flat top looks the same from anywhere along it: a candidate may lie at its very end.
    Where it is hardly longer than the object is wide, reaching on would reach the neighbours.
    """
    narrow = min(field.size[0], field.size[1]) / 2
    reach_x = field.top_half[0] if field.top_half[0] > LONG_TOP * narrow else limits.offset_m
    reach_y = field.top_half[1] if field.top_half[1] > LONG_TOP * narrow else limits.offset_m
    return int(math.ceil(reach_x / limits.step_m)), int(math.ceil(reach_y / limits.step_m))


def has_long_top(field: ModelField) -> bool:
    """Whether a candidate may lie anywhere along the top of a model."""
    narrow = min(field.size[0], field.size[1]) / 2
    return bool(field.top_half.max() > LONG_TOP * narrow)


@inner
def search_reach(field, limits):
    """How far from a candidate the points of the object may lie, metres."""
    side_x, side_y = offset_steps(field, limits)
    offset = limits.step_m * math.hypot(side_x, side_y)
    half_diagonal = math.hypot(field.size[0], field.size[1]) / 2
    return half_diagonal * (1 + limits.stretch) + offset + limits.coarse_gate_m


@inner
def gain_bounds(body, ground, field, limits, base, tall, enough, bounds):
    """Fill ``bounds`` with upper bounds of the gains of headings and offsets around the origin.

    Headings, then offsets along x and y, as ``coarse_search`` tries them; base and tall are height
    and vertical stretch of all poses.
    """
    nx, ny, nz = field.clearance.shape
    clearance = field.clearance.reshape(nx * ny * nz)
    footprint = field.footprint.reshape(nx * ny)
    weights, ground_weights = body.weights.astype(np.float32), ground.weights.astype(np.float32)
    levels = _levels(body.xyz, field, base, tall)
    body_x, body_y = _in_voxels(body.xyz, field.voxel_m)
    ground_x, ground_y = _in_voxels(ground.xyz, field.voxel_m)
    side_x, side_y = offset_steps(field, limits)
    step = limits.step_m / field.voxel_m
    first_x = (field.top[0] - field.origin[0]) / field.voxel_m + side_x * step
    first_y = (field.top[1] - field.origin[1]) / field.voxel_m + side_y * step
    # stretched less than once, distances are shorter than the clearance
    shrunk = min(1.0, tall) / limits.coarse_gate_m
    per_m2 = np.float32(shrunk * shrunk)
    along = _columns(2 * side_x + 1, len(weights), len(ground_weights))
    across = _columns(2 * side_y + 1, len(weights), len(ground_weights))
    n = 0
    for h in range(limits.headings):
        yaw = 2 * math.pi * h / limits.headings
        c, s = math.cos(yaw), math.sin(yaw)
        turned = _turned(body_x, body_y, c, s, first_x)
        sideways = _turned(body_y, body_x, c, -s, first_y)
        ground_turned = _turned(ground_x, ground_y, c, s, first_x)
        ground_sideways = _turned(ground_y, ground_x, c, -s, first_y)
        for i in range(2 * side_x + 1):
            shift = np.float32(i * step)
            _number(turned, shift, nx, ny * nz, along.body[i])
            _number_surely(ground_turned, shift, nx, ny, along.ground[i])
        for j in range(2 * side_y + 1):
            shift = np.float32(j * step)
            _number(sideways, shift, ny, nz, across.body[j])
            _add(across.body[j], levels)
            _number_surely(ground_sideways, shift, ny, 1, across.ground[j])
        for i in range(2 * side_x + 1):
            for j in range(2 * side_y + 1):
                explained, unexplained = _sums(
                    clearance, along.body[i], across.body[j], weights, per_m2
                )
                hidden = _hidden(footprint, along.ground[i], across.ground[j], ground_weights)
                bounds[n] = ROUNDING * gain(
                    np.float64(explained), np.float64(unexplained) + hidden, enough
                )
                n += 1


@inner
def _columns(offsets, bodies, grounds):
    return Columns(np.empty((offsets, bodies), np.uint32), np.empty((offsets, grounds), np.uint32))


@inner
def _in_voxels(xyz, voxel):
    """Horizontal coordinates in voxels."""
    u, v = np.empty(xyz.shape[0], np.float32), np.empty(xyz.shape[0], np.float32)
    for n in range(xyz.shape[0]):
        u[n] = xyz[n, 0] / voxel
        v[n] = xyz[n, 1] / voxel
    return u, v


@inner
def _levels(xyz, field, base, tall):
    """Layer of the model's grid that each point is in, the nearest one if in none."""
    levels = np.empty(xyz.shape[0], np.uint32)
    last = field.clearance.shape[2] - 1.0
    for n in range(xyz.shape[0]):
        level = ((xyz[n, 2] - base) / tall - field.origin[2]) / field.voxel_m
        levels[n] = np.uint32(min(max(level, 0.0), last))
    return levels


@inner
def _turned(u, v, c, s, first):
    """One coordinate of points in the object frame at the first offset, from the grid's corner."""
    c, s, first = np.float32(c), np.float32(s), np.float32(first)
    turned = np.empty(len(u), np.float32)
    for n in range(len(u)):
        turned[n] = c * u[n] + s * v[n] + first
    return turned


@inner
def _number(u, shift, count, factor, numbers):
    """Column of each point, the nearest one if in none, times a factor (vectorised)."""
    last, factor = np.float32(count - 1), np.uint32(factor)
    for n in range(len(u)):
        numbers[n] = np.uint32(min(max(u[n] - shift, np.float32(0)), last)) * factor


@inner
def _number_surely(u, shift, count, factor, numbers):
    """The same, column 0 wherever rounding may decide: the footprint is not there."""
    last, factor = np.float32(count - 1), np.uint32(factor)
    low, high = np.float32(DOUBT), np.float32(1 - DOUBT)
    for n in range(len(u)):
        place = min(max(u[n] - shift, np.float32(0)), last)
        column = np.uint32(place)
        within = place - np.float32(column)
        numbers[n] = column * factor if (within > low and within < high) else np.uint32(0)


@inner
def _add(numbers, more):
    for n in range(len(numbers)):
        numbers[n] += more[n]


@reordered
def _sums(clearance, along, across, weights, per_m2):
    """The most that points explain, and the least that they leave unexplained (vectorised)."""
    zero, one = np.float32(0), np.float32(1)
    explained, unexplained = zero, zero
    for n in range(len(weights)):
        least = clearance[np.uint64(along[n] + across[n])]
        share = one - abs(least) * per_m2
        explained += weights[n] * max(share, zero)
        unexplained += weights[n] if (share <= zero and least < zero) else zero
    return explained, unexplained


@reordered
def _hidden(footprint, along, across, weights):
    """Weight of the ground in the footprint (vectorised)."""
    hidden = np.float32(0)
    for n in range(len(weights)):
        hidden += weights[n] if footprint[np.uint64(along[n] + across[n])] else np.float32(0)
    return hidden
