"""Plain twins of the coarse search: all poses by themselves, and the bounds of their gains."""

from __future__ import annotations

import math

import numpy as np
from tests.unit.verify.twins.scene import cut_out, look_up, to_object, total

from spinpipe.stages.verify.fit import coarse_bounds, coarse_search
from spinpipe.stages.verify.scene.candidate_points import TOO_FEW


def search_reach(field, limits):
    """How far from a candidate the points of an object may lie."""
    steps = offset_steps(field, limits)
    half_diagonal = math.hypot(field.size[0], field.size[1]) / 2
    offset = limits.step_m * math.hypot(*steps)
    return half_diagonal * (1 + limits.stretch) + offset + limits.coarse_gate_m


def offset_steps(field, limits):
    """Steps along x and y."""
    narrow = field.size[:2].min() / 2
    long = field.top_half > coarse_bounds.LONG_TOP * narrow
    reach = np.where(long, field.top_half, limits.offset_m)
    return np.ceil(reach / limits.step_m).astype(int)


def coarse_fit(body, ground, field, pose, gate, enough):
    """How purely a pose explains what it claims, 0..1."""
    u = to_object(pose, body.xyz)
    k = look_up(field.nearest, field, u / pose[4:])
    ex, ey, ez = (u - pose[4:] * field.samples[k]).T
    share = 1 - (ex * ex + ey * ey + ez * ez) * (1 / (gate * gate))
    near = k >= 0
    boxed = (np.abs(u[:, :2]) < field.size[:2] / 2 * pose[4:6]).all(axis=1)
    boxed &= (u[:, 2] > 0) & (u[:, 2] < field.size[2] * pose[6])
    explained = total((body.weights * share)[near & (share > 0)])
    over = to_object(pose, ground.xyz)[:, :2] / pose[4:6]
    hidden = look_up(field.footprint, field, over) > 0
    left = np.concatenate([body.weights[near & (share <= 0) & boxed], ground.weights[hidden]])
    if explained <= 0:
        return 0.0
    return explained / (explained + total(left)) * explained / (explained + enough)


def gain_bounds(body, ground, field, limits, base, tall, enough):
    """See ``coarse_bounds.gain_bounds``: (P,) in the order of ``poses_to_try``."""
    f32, voxel, counts = np.float32, field.voxel_m, np.array(field.clearance.shape)
    steps, step = offset_steps(field, limits), limits.step_m / voxel
    first = ((field.top[:2] - field.origin[:2]) / voxel + steps * step).astype(f32)
    level = ((body.xyz[:, 2] - base) / tall - field.origin[2]) / voxel
    level = np.clip(level, 0, counts[2] - 1).astype(int)
    per_m2 = f32((min(1.0, tall) / limits.coarse_gate_m) ** 2)
    bounds = []

    def columns(xyz, yaw, i, j):
        """Places in voxels from the grid's corner, none of them outside."""
        x, y = (xyz[:, :2] / voxel).astype(f32).T
        c, s = f32(math.cos(yaw)), f32(math.sin(yaw))
        shift = np.array([i * step, j * step]).astype(f32)
        turned = np.column_stack([c * x + s * y, c * y - s * x]) + first - shift
        return np.clip(turned, f32(0), (counts[:2] - 1).astype(f32))

    for h in range(limits.headings):
        yaw = 2 * math.pi * h / limits.headings
        for i in range(2 * steps[0] + 1):
            for j in range(2 * steps[1] + 1):
                cell = columns(body.xyz, yaw, i, j).astype(int)
                least = field.clearance[cell[:, 0], cell[:, 1], level]
                share = 1 - np.abs(least) * per_m2
                explained = (body.weights * np.maximum(share, 0)).sum()
                left = body.weights[(share <= 0) & (least < 0)].sum()
                place = columns(ground.xyz, yaw, i, j)
                doubt = np.minimum(place % 1, 1 - place % 1) <= coarse_bounds.DOUBT
                cell = np.where(doubt, 0, place.astype(int))  # surely not below the footprint
                left += ground.weights[field.footprint[cell[:, 0], cell[:, 1]]].sum()
                gain = explained / (explained + left) if explained > 0 else 0.0
                bounds.append(coarse_bounds.ROUNDING * gain * explained / (explained + enough))
    return np.array(bounds)


def poses_to_try(field, limits, top):
    """Every heading at whole steps around the origin."""
    tall = np.clip(top / field.top_level, 1 - limits.stretch, 1 + limits.stretch)
    base = top - tall * field.top_level if limits.stretch > 0 else 0.0
    tall = tall if limits.stretch > 0 else 1.0
    along, across = (np.arange(-n, n + 1) * limits.step_m for n in offset_steps(field, limits))
    poses = []
    for h in range(limits.headings):
        yaw = 2 * math.pi * h / limits.headings
        cos, sin = math.cos(yaw), math.sin(yaw)
        for dx in along:
            for dy in across:
                ox, oy = dx - field.top[0], dy - field.top[1]
                poses.append([cos * ox - sin * oy, sin * ox + cos * oy, base, yaw, 1.0, 1.0, tall])
    return np.array(poses)


def is_distinct(pose, others, limits):
    """Whether a pose is more than a step or a heading away from all others."""
    turn = np.abs((pose[3] - others[:, 3] + math.pi) % (2 * math.pi) - math.pi)
    shift = np.hypot(pose[0] - others[:, 0], pose[1] - others[:, 1])
    same = (turn < 2.1 * math.pi / limits.headings) & (shift < 2.5 * limits.step_m)
    return not same.any()


def coarse_points(scene, field, limits, top):
    """Points that the coarse search goes by, and the weight that is enough to convince."""
    ceiling = top + field.size[2] * limits.stretch + 2 * limits.coarse_gate_m
    reach = search_reach(field, limits)
    cut = cut_out(scene, (0.0, 0.0), reach, limits.low_m, ceiling, coarse_search.COARSE_POINTS)
    return *cut, 0.1 * field.size[0] * field.size[1] / (scene.cell_m * scene.cell_m)


def coarse_gains(scene, field, limits, top):
    """Poses to try and the gain of each by itself."""
    body, ground, enough = coarse_points(scene, field, limits, top)
    poses = poses_to_try(field, limits, top)
    gains = np.zeros(len(poses))
    if len(body.xyz) >= TOO_FEW:
        gate = limits.coarse_gate_m
        gains[:] = [coarse_fit(body, ground, field, pose, gate, enough) for pose in poses]
    return poses, gains


def coarse_poses(scene, field, limits, top, keep):
    """The best poses of all that are distinct, and their gains."""
    poses, gains = coarse_gains(scene, field, limits, top)
    kept: list[int] = []
    for n in np.argsort(-gains, kind="stable"):
        if gains[n] > 0 and is_distinct(poses[n], poses[kept], limits):
            kept.append(int(n))
        if len(kept) == keep:
            break
    return poses[kept], gains[kept]
