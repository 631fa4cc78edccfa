"""Coarse search: every heading at offsets around a place, so that no start is missed; compiled."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.fit.coarse_bounds import gain, gain_bounds, offset_steps, search_reach
from spinpipe.stages.verify.model.lookup import nearest_sample
from spinpipe.stages.verify.model.pose import POSE, pose_of, to_object
from spinpipe.stages.verify.scene.candidate_points import TOO_FEW, cut_out

COARSE_POINTS = 400


@njit(nogil=True, error_model="numpy")
def coarse_fit(body, ground, field, pose_row, gate, enough):
    """How purely a pose explains what it claims, for comparing poses of a coarse search.

    Parameters
    ----------
    body, ground : Points.
    field : ModelField.
    pose_row : (7,) float64.
    gate : residual at which a point stops being explained, metres.
    enough : weight of explained points that is convincing in itself.

    Returns
    -------
    float
        e / (e + u) * e / (e + enough), 0..1: e sums w (1 - d^2 / gate^2) over explained points, u
        the weight of unexplained points in the bounding box and of ground seen where the model
        would hide it. A sparsely sampled object fits as well as a dense one.
    """
    pose = pose_of(pose_row)
    sx, sy, sz = pose.stretch_x, pose.stretch_y, pose.stretch_z
    half_x, half_y = field.size[0] / 2 * sx, field.size[1] / 2 * sy
    top = field.size[2] * sz
    origin, inv, footprint = field.origin, 1.0 / field.voxel_m, field.footprint
    samples = field.samples
    inv_gate2 = 1.0 / (gate * gate)
    explained = 0.0
    unexplained = 0.0
    points, weights = body.xyz, body.weights
    for n in range(points.shape[0]):
        ux, uy, uz = to_object(pose, points[n, 0], points[n, 1], points[n, 2])
        k = nearest_sample(field, ux / sx, uy / sy, uz / sz)
        if k < 0:
            continue
        ex, ey, ez = ux - sx * samples[k, 0], uy - sy * samples[k, 1], uz - sz * samples[k, 2]
        share = 1.0 - (ex * ex + ey * ey + ez * ez) * inv_gate2
        if share > 0.0:
            explained += weights[n] * share
        elif abs(ux) < half_x and abs(uy) < half_y and 0.0 < uz < top:
            unexplained += weights[n]
    points, weights = ground.xyz, ground.weights
    for n in range(points.shape[0]):
        ux, uy, _ = to_object(pose, points[n, 0], points[n, 1], 0.0)
        i = int(math.floor((ux / sx - origin[0]) * inv))
        j = int(math.floor((uy / sy - origin[1]) * inv))
        if 0 <= i < footprint.shape[0] and 0 <= j < footprint.shape[1] and footprint[i, j]:
            unexplained += weights[n]
    return gain(explained, unexplained, enough)


@inner
def coarse_search(scene, field, limits, top, poses, gains):
    """Fill ``poses`` (K, 7) and ``gains`` (K,) with the best distinct coarse fits at a place.

    Every heading is tried at offsets of whole steps around the place; what cannot be among the best
    by its bound is not looked at.

    Parameters
    ----------
    scene : CellGrid, in the frame of the support: the candidate is at x = y = 0.
    field : ModelField.
    limits : Tolerance.
    top : height of the candidate above its support, metres.
    """
    reach = search_reach(field, limits)
    ceiling = top + field.size[2] * limits.stretch + 2 * limits.coarse_gate_m
    body, ground = cut_out(scene, 0.0, 0.0, reach, limits.low_m, ceiling, COARSE_POINTS)
    if body.xyz.shape[0] < TOO_FEW:
        return
    tried = poses_to_try(field, limits, top)
    # a tenth of the footprint, in cells of equal surface
    enough = 0.1 * field.size[0] * field.size[1] / (scene.cell_m * scene.cell_m)
    bounds = np.empty(tried.shape[0])
    first = pose_of(tried[0])
    gain_bounds(body, ground, field, limits, first.z, first.stretch_z, enough, bounds)
    # best first: the pose found is the one that an exhaustive search would find
    order = np.argsort(-bounds)
    open_gains = np.zeros(tried.shape[0])
    looked_at = 0
    for kept in range(poses.shape[0]):
        best = -1
        for n in order[:looked_at]:
            if not is_distinct(tried[n], poses[:kept], limits):
                open_gains[n] = 0.0
            best = _better(open_gains, n, best)
        while looked_at < len(order):
            n = order[looked_at]
            if bounds[n] <= 0.0 or (best >= 0 and bounds[n] < open_gains[best]):
                break
            looked_at += 1
            if is_distinct(tried[n], poses[:kept], limits):
                open_gains[n] = coarse_fit(
                    body, ground, field, tried[n], limits.coarse_gate_m, enough
                )
                best = _better(open_gains, n, best)
        if best < 0:
            break
        poses[kept] = tried[best]
        gains[kept] = open_gains[best]


@inner
def _better(gains, n, best):
    """The one of greater gain, the earlier one if equal; none (-1) is better than no gain."""
    if gains[n] <= 0.0 or (best >= 0 and gains[n] < gains[best]):
        return best
    if best >= 0 and gains[n] == gains[best]:
        return min(n, best)
    return n


@inner
def poses_to_try(field, limits, top):
    """Poses to try, (headings * offsets, 7)."""
    # where the model is rigid another one may have proposed the place: only its xy counts
    tall = 1.0
    base = 0.0
    if limits.stretch > 0.0:
        tall = top / field.top_level
        tall = min(max(tall, 1.0 - limits.stretch), 1.0 + limits.stretch)
        base = top - tall * field.top_level
    side_x, side_y = offset_steps(field, limits)
    poses = np.ones((limits.headings * (2 * side_x + 1) * (2 * side_y + 1), POSE))
    n = 0
    for h in range(limits.headings):
        yaw = 2 * math.pi * h / limits.headings
        cos, sin = math.cos(yaw), math.sin(yaw)
        for i in range(-side_x, side_x + 1):
            for j in range(-side_y, side_y + 1):
                ox, oy = i * limits.step_m - field.top[0], j * limits.step_m - field.top[1]
                poses[n, 0] = cos * ox - sin * oy
                poses[n, 1] = sin * ox + cos * oy
                poses[n, 2] = base
                poses[n, 3] = yaw
                poses[n, 6] = tall
                n += 1
    return poses


@inner
def is_distinct(pose, others, limits):
    """Whether a pose is more than a step or a heading away from all others."""
    one = pose_of(pose)
    for k in range(others.shape[0]):
        other = pose_of(others[k])
        turn = abs((one.yaw - other.yaw + math.pi) % (2 * math.pi) - math.pi)
        shift = math.hypot(one.x - other.x, one.y - other.y)
        if turn < 2.1 * math.pi / limits.headings and shift < 2.5 * limits.step_m:
            return False
    return True
