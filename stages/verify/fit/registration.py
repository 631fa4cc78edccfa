"""Registration of a model to the points around a candidate in four upright degrees of freedom.

x, y, z and yaw, and where a model may stretch also its three extents: iteratively reweighted
Gauss-Newton on point-to-plane residuals [Chen & Medioni 1992; Fitzgibbon 2003] from a start of the
coarse search to convergence. Compiled; nothing is random.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from spinpipe.schemas.arrays import F64
from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.model.lookup import inside_depth, nearest_edge, nearest_sample
from spinpipe.stages.verify.model.pose import POSE, pose_of, to_object
from spinpipe.stages.verify.scene.candidate_points import thinned

STEPS = 12
"""Iterations at one gate, at most."""
PASSES = 3
"""Gates that a candidate's registration goes through."""
SETTLED = (0.1, 0.01)
"""A step below this share of the gate ends a pass, and the last pass: chosen."""
FIRST_POINTS = 300
"""About how many points tell the way at the first gate, twice as many at the next, all at the last:
chosen."""


class Base(NamedTuple):
    """Where the base should stand and how sure that is, metres; free if ``sd`` is not positive."""

    z: float
    sd: float


class Residuals(NamedTuple):
    """Room for weighted residuals: (N,) weights, (N, 8) rows of the Jacobian and the residual."""

    weights: F64
    rows: F64


@njit(nogil=True, error_model="numpy")
def refine(body, ground, field, start, gates, stretch, base, course):
    """Gauss-Newton from one start, the gate narrowing from pass to pass.

    Parameters
    ----------
    body, ground : Points. Ground seen inside the footprint pushes the footprint off itself, as far
        as the body hides the ground at all.
    field : ModelField.
    start : (7,) float64.
    gates : (G,) float64, residual gates of the passes, metres.
    stretch : largest relative stretch per axis, 0 for a rigid model.
    base : Base.
    course : (I, 7) float64, filled with the first I poses on the way, from the start on.

    Returns
    -------
    pose : (7,) float64.
    converged : bool, whether the last pass settled.
    steps : how many steps were made.
    """
    pose = start.copy()
    dof = POSE if stretch > 0.0 else 4
    A, b = np.empty((dof, dof)), np.empty(dof)
    room = body.xyz.shape[0] + ground.xyz.shape[0]
    residuals = Residuals(np.empty(room), np.empty((room, POSE + 1)))
    converged = False
    steps = 0
    for narrowing in range(len(gates)):
        gate = gates[narrowing]
        last = narrowing == len(gates) - 1
        some = body if last else thinned(body, FIRST_POINTS << narrowing)
        inset = 0.5 * gates[-1]
        hides = _hides_ground(ground, field, pose_of(pose), gate + inset)
        for _ in range(STEPS):
            if steps < course.shape[0]:
                course[steps] = pose
            at = pose_of(pose)
            count, total = _add_body(residuals, some, field, at, gate)
            if total <= 0.0:
                return pose, False, steps
            if hides >= 0.5:
                count = _add_ground(residuals, count, ground, field, at, gate, inset, hides)
            _sum_up(residuals, count, A, b)
            _add_priors(A, b, pose, total, gate, field.outermost_m, stretch, base)
            step = np.linalg.solve(A, b)
            # no step beyond the gate: the correspondences would be others
            moved = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
            moved = max(moved, abs(step[3]) * field.outermost_m)
            shrink = min(1.0, gate / moved) if moved > 0.0 else 1.0
            for i in range(dof):
                pose[i] += shrink * step[i]
            if stretch > 0.0:
                for i in range(4, POSE):
                    pose[i] = min(max(pose[i], 1.0 - stretch), 1.0 + stretch)
            steps += 1
            converged = moved < (SETTLED[1] if last else SETTLED[0]) * gate
            if converged:
                break
    return pose, converged, steps


@inner
def _add_body(residuals, body, field, pose, gate):
    """Distances of points to the planes through their nearest samples: how many, their weight."""
    surface = field.surface
    points, weights = body
    inv_gate2 = 1.0 / (gate * gate)
    c, s = pose.cos, pose.sin
    sx, sy, sz = pose.stretch_x, pose.stretch_y, pose.stretch_z
    count = 0
    total = 0.0
    for n in range(points.shape[0]):
        ux, uy, uz = to_object(pose, points[n, 0], points[n, 1], points[n, 2])
        k = nearest_sample(field, ux / sx, uy / sy, uz / sz)
        if k < 0:
            continue
        x, y, z = surface[k, 0], surface[k, 1], surface[k, 2]
        ex, ey, ez = ux - sx * x, uy - sy * y, uz - sz * z
        w = 1.0 - (ex * ex + ey * ey + ez * ez) * inv_gate2
        if w <= 0.0:
            continue
        w = weights[n] * w * w  # Tukey's biweight
        nx, ny, nz = surface[k, 3] / sx, surface[k, 4] / sy, surface[k, 5] / sz
        norm = math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / norm, ny / norm, nz / norm
        row = residuals.rows[count]
        row[0] = -(c * nx - s * ny)
        row[1] = -(s * nx + c * ny)
        row[2] = -nz
        row[3] = nx * uy - ny * ux
        row[4] = -nx * x
        row[5] = -ny * y
        row[6] = -nz * z
        row[7] = nx * ex + ny * ey + nz * ez
        residuals.weights[count] = w
        total += w
        count += 1
    return count, total


@inner
def _add_ground(residuals, count, ground, field, pose, gate, inset, hides):
    """How far ground lies inside the nearest edge of the footprint; returns how many there are."""
    edges = field.edges
    inv_gate2 = 1.0 / (gate * gate)
    c, s = pose.cos, pose.sin
    sx, sy = pose.stretch_x, pose.stretch_y
    for n in range(ground.xyz.shape[0]):
        ux, uy, _ = to_object(pose, ground.xyz[n, 0], ground.xyz[n, 1], 0.0)
        e = nearest_edge(field, ux / sx, uy / sy)
        if e < 0:
            continue
        nx, ny = edges[e, 2] / sx, edges[e, 3] / sy
        norm = math.sqrt(nx * nx + ny * ny)
        nx, ny = nx / norm, ny / norm
        # some ground is seen below an overhanging body: the last half gate is free
        r = nx * (sx * edges[e, 0] - ux) + ny * (sy * edges[e, 1] - uy) - inset
        if r <= 0.0 or r >= gate:
            continue
        w = 1.0 - r * r * inv_gate2
        row = residuals.rows[count]
        row[0] = c * nx - s * ny
        row[1] = s * nx + c * ny
        row[2] = 0.0
        row[3] = ny * ux - nx * uy
        row[4] = nx * edges[e, 0]
        row[5] = ny * edges[e, 1]
        row[6] = 0.0
        row[7] = r
        residuals.weights[count] = ground.weights[n] * hides * w * w
        count += 1
    return count


@inner
def _sum_up(residuals, count, A, b):
    """Normal equations A step = b of the residuals: the lower triangle of A, and b."""
    weights, rows = residuals
    for i in range(b.shape[0]):
        s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
        for n in range(count):
            wj = weights[n] * rows[n, i]
            s0 += wj * rows[n, 0]
            s1 += wj * rows[n, 1]
            s2 += wj * rows[n, 2]
            s3 += wj * rows[n, 3]
            s4 += wj * rows[n, 4]
            s5 += wj * rows[n, 5]
            s6 += wj * rows[n, 6]
            s7 += wj * rows[n, 7]
        sums = (s0, s1, s2, s3, s4, s5, s6)
        for j in range(i + 1):
            A[i, j] = sums[j]
        b[i] = -s7


@inner
def _add_priors(A, b, pose, total, gate, reach, stretch, base):
    """Complete the matrix: damping, the base on the ground, sizes near the stated ones."""
    for i in range(b.shape[0]):
        for j in range(i):
            A[j, i] = A[i, j]
        # a little damping keeps a direction that no point sees where it is
        A[i, i] += 1e-4 * total * (reach * reach if i == 3 else 1.0)
    if base.sd > 0.0:
        # the ground counts as much as a tenth of the points
        pull = 0.1 * total * min(1.0, (gate / base.sd) ** 2)
        A[2, 2] += pull
        b[2] += pull * (base.z - pose[2])
    if stretch > 0.0:
        # prior: the stated bound is two standard deviations of the size
        prior = 0.02 * total * (gate / stretch) ** 2
        for i in range(4, POSE):
            A[i, i] += prior
            b[i] += prior * (1.0 - pose[i])


@inner
def _hides_ground(ground, field, pose, inset):
    """How much less ground is seen well inside the footprint than around it, 0..1.

    Near 1 the outline of the hole in the ground shows where the body stands, even one that returns
    next to no points itself; near 0 the scene shows what is below things too.
    """
    area_inside, area_outside = _areas(field, inset)
    inside = 0.0
    outside = 0.0
    for n in range(ground.xyz.shape[0]):
        ux, uy, _ = to_object(pose, ground.xyz[n, 0], ground.xyz[n, 1], 0.0)
        depth = inside_depth(field, ux / pose.stretch_x, uy / pose.stretch_y)
        if depth > inset:
            inside += ground.weights[n]
        elif depth < 0.0 and depth > -np.inf:
            outside += ground.weights[n]
    if outside <= 0.0 or area_inside <= 0.0 or area_outside <= 0.0:
        return 0.0
    return max(0.0, 1.0 - (inside / area_inside) / (outside / area_outside))


@inner
def _areas(field, inset):
    """Columns of the field's grid well inside the footprint, and those outside of it."""
    depths = field.depths
    inside = len(depths) - np.searchsorted(depths, inset, side="right")
    return float(inside), float(np.searchsorted(depths, 0.0))
