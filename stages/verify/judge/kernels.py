"""Compiled batches of coarse search, refinement and evidence, see ``hypotheses``.

Only these outermost kernels are cached on disk, see ``compiled``.
"""

from __future__ import annotations

import math

import numpy as np

from spinpipe.stages.compiled import inner, kept
from spinpipe.stages.verify.evidence.gather import gather_evidence
from spinpipe.stages.verify.evidence.scene import root_mean_square, scene_evidence
from spinpipe.stages.verify.fit.coarse_bounds import search_reach
from spinpipe.stages.verify.fit.coarse_search import coarse_search
from spinpipe.stages.verify.fit.registration import Base, refine
from spinpipe.stages.verify.model.lookup import half_diagonal
from spinpipe.stages.verify.model.pose import POSE, pose_of
from spinpipe.stages.verify.scene.candidate_points import TOO_FEW, cut_out
from spinpipe.stages.verify.scene.cell_grid import seen_from

FINE_POINTS = 1200


@inner
def _fine_points(scene, field, limits, start):
    """Points to refine a pose with and to judge it by: of bodies, of the ground."""
    reach = half_diagonal(field) * (1 + limits.stretch) + 2 * limits.coarse_gate_m
    ceiling = start[2] + field.size[2] * (1 + 2 * limits.stretch) + 2 * limits.coarse_gate_m
    return cut_out(scene, start[0], start[1], reach, limits.low_m, ceiling, FINE_POINTS)


@inner
def _gates(limits):
    """Gates of the passes of a registration."""
    coarse, fine = limits.coarse_gate_m, limits.gate_m
    return np.array([coarse, math.sqrt(coarse * fine), fine])


@kept("verify")
def local_scene(grid, origin, axes, radius):
    """The points around a place in the frame of its support, see ``cell_grid.seen_from``."""
    return seen_from(grid, origin, axes, radius)


@kept("verify")
def reach(field, limits):
    """How far from a candidate the points of an object may lie, metres."""
    return search_reach(field, limits)


@kept("verify")
def coarse_fits(scene, field, limits, top, poses, gains):
    """Fill ``poses`` (K, 7) and ``gains`` (K,) with the best coarse fits of a candidate."""
    coarse_search(scene, field, limits, top, poses, gains)


@kept("verify")
def refined(scene, field, limits, poses, evidence):
    """Refine each of ``poses`` (S, 7) in place and fill its row of the evidence (S, E)."""
    gates = _gates(limits)
    base = Base(0.0, limits.gate_m if limits.stretch > 0.0 else 0.0)
    no_course = np.empty((0, POSE))
    for c in range(poses.shape[0]):
        body, ground = _fine_points(scene, field, limits, poses[c])
        if body.xyz.shape[0] < TOO_FEW:
            continue
        pose, _, _ = refine(body, ground, field, poses[c], gates, limits.stretch, base, no_course)
        poses[c] = pose
        at = pose_of(pose)
        found = gather_evidence(scene, body, field, at, limits.gate_m, limits.sharp_m)
        for k in range(len(found)):
            evidence[c, k] = found[k]


@kept("verify")
def course(scene, field, limits, start, course, rms_m):
    """One registration of ``refined`` again, with the way there.

    Fills poses (I, 7) and residuals (I,), before each step and after the last; returns how many
    there are.
    """
    body, ground = _fine_points(scene, field, limits, start)
    if body.xyz.shape[0] < TOO_FEW:
        return 0
    base = Base(0.0, limits.gate_m if limits.stretch > 0.0 else 0.0)
    gates = _gates(limits)
    pose, _, steps = refine(body, ground, field, start, gates, limits.stretch, base, course)
    count = min(steps + 1, course.shape[0])
    free = np.ones(4, np.bool_)
    course[count - 1] = pose
    for k in range(count):
        claim = scene_evidence(body, field, pose_of(course[k]), limits.gate_m, free)
        rms_m[k] = root_mean_square(claim)
    return count
