"""Compiled batches of coarse search, refinement and evidence, see ``hypotheses``.

Only these outermost kernels are cached on disk, see ``compiled``.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from spinpipe.stages.compiled import inner, sources
from spinpipe.stages.verify.evidence.gather import gather_evidence
from spinpipe.stages.verify.evidence.scene import root_mean_square, scene_evidence
from spinpipe.stages.verify.fit.coarse_search import coarse_search
from spinpipe.stages.verify.fit.registration import Base, refine
from spinpipe.stages.verify.model.lookup import POSE, half_diagonal
from spinpipe.stages.verify.scene.candidate_points import TOO_FEW, cut_out

FINE_POINTS = 1200


@inner
def _fine_points(grid, field, limits, start):
    """Points to refine a pose with and to judge it by: of bodies, of the ground."""
    reach = half_diagonal(field) * (1 + limits.stretch) + 2 * limits.coarse_gate_m
    ceiling = start[2] + field.size[2] * (1 + 2 * limits.stretch) + 2 * limits.coarse_gate_m
    return cut_out(grid, start[0], start[1], reach, limits.low_m, ceiling, FINE_POINTS)


@inner
def _gates(limits):
    """Gates of the passes of a registration."""
    coarse, fine = limits.coarse_gate_m, limits.gate_m
    return np.array([coarse, math.sqrt(coarse * fine), fine])


def _kernels(sources: str):
    """Define the outermost kernels; numba keys its cache by the values they enclose."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def coarse_batch(grid, field, limits, places, ground_z, poses, gains):
        """Fill ``poses`` (C, K, 7) and ``gains`` (C, K) with the best coarse fits of each place."""
        _ = sources
        for c in range(places.shape[0]):
            coarse_search(grid, field, limits, places[c], ground_z[c], poses[c], gains[c])

    @njit(cache=True, nogil=True, error_model="numpy")
    def refine_batch(grid, field, limits, ground_z, poses, evidence):
        """Refine each of ``poses`` (S, 7) in place and fill its row of the evidence (S, E)."""
        _ = sources
        gates = _gates(limits)
        base_sd = limits.gate_m if limits.stretch > 0.0 else 0.0
        no_course = np.empty((0, POSE))
        for c in range(poses.shape[0]):
            body, ground = _fine_points(grid, field, limits, poses[c])
            if body.xyz.shape[0] < TOO_FEW:
                continue
            base = Base(ground_z[c], base_sd)
            pose, _, _ = refine(
                body, ground, field, poses[c], gates, limits.stretch, base, no_course
            )
            poses[c] = pose
            found = gather_evidence(grid, body, field, pose, limits.gate_m, limits.sharp_m)
            for k in range(len(found)):
                evidence[c, k] = found[k]

    @njit(cache=True, nogil=True, error_model="numpy")
    def refine_course(grid, field, limits, ground_z, start, course, rms_m):
        """One registration of ``refine_batch`` again, with the way there.

        Fills poses (I, 7) and residuals (I,), before each step and after the last; returns how many
        there are.
        """
        _ = sources
        body, ground = _fine_points(grid, field, limits, start)
        if body.xyz.shape[0] < TOO_FEW:
            return 0
        base = Base(ground_z, limits.gate_m if limits.stretch > 0.0 else 0.0)
        gates = _gates(limits)
        pose, _, steps = refine(body, ground, field, start, gates, limits.stretch, base, course)
        count = min(steps + 1, course.shape[0])
        free = np.ones(4, np.bool_)
        course[count - 1] = pose
        for k in range(count):
            claim = scene_evidence(body, field, course[k], limits.gate_m, free)
            rms_m[k] = root_mean_square(claim)
        return count

    return coarse_batch, refine_batch, refine_course


coarse_batch, refine_batch, refine_course = _kernels(sources("verify"))
