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
from numpy.typing import NDArray

from spinpipe.stages.compiled import inner
from spinpipe.stages.field_lookup import POSE, nearest_edge, nearest_sample
from spinpipe.stages.ground_hole import hides_ground

STEPS = 12
"""Iterations at one gate, at most."""


class Base(NamedTuple):
    """Where the base should stand and how sure that is, metres; free if ``sd`` is not positive."""

    z: float
    sd: float


class Equations(NamedTuple):
    """Normal equations A step = b, lower triangle, with room for one row of the Jacobian."""

    A: NDArray[np.float64]
    b: NDArray[np.float64]
    row: NDArray[np.float64]


@njit(nogil=True, error_model="numpy")
def refine(body, ground, field, start, gates, stretch, base):
    """Gauss-Newton from one start, the gate narrowing from pass to pass.

    Parameters
    ----------
    body, ground : Points. Ground seen inside the footprint pushes the footprint off itself, as far
        as the body hides the ground at all.
    field : FieldArrays.
    start : (7,) float64.
    gates : (G,) float64, residual gates of the passes, metres.
    stretch : largest relative stretch per axis, 0 for a rigid model.
    base : Base.

    Returns
    -------
    pose : (7,) float64.
    converged : bool, the last step was below a thousandth of the gate.
    """
    pose = start.copy()
    dof = POSE if stretch > 0.0 else 4
    converged = False
    reach = _reach(field)
    for gate in gates:
        inset = 0.5 * gates[-1]
        hides = hides_ground(ground, field, pose, gate + inset)
        for _ in range(STEPS):
            equations = Equations(np.zeros((dof, dof)), np.zeros(dof), np.zeros(POSE))
            total = _add_body(equations, body, field, pose, gate)
            if total <= 0.0:
                return pose, False
            if hides >= 0.5:
                _add_ground(equations, ground, field, pose, gate, inset, hides)
            _add_priors(equations, pose, total, gate, reach, stretch, base)
            step = np.linalg.solve(equations.A, equations.b)
            # no step beyond the gate: the correspondences would be others
            moved = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
            moved = max(moved, abs(step[3]) * reach)
            shrink = min(1.0, gate / moved) if moved > 0.0 else 1.0
            for i in range(dof):
                pose[i] += shrink * step[i]
            if stretch > 0.0:
                for i in range(4, POSE):
                    pose[i] = min(max(pose[i], 1.0 - stretch), 1.0 + stretch)
            converged = moved < 1e-3 * gate
            if converged:
                break
    return pose, converged


@inner
def _reach(field):
    """Horizontal distance of the outermost sample from the base centre."""
    reach = 0.0
    for k in range(field.samples.shape[0]):
        reach = max(reach, field.samples[k, 0] ** 2 + field.samples[k, 1] ** 2)
    return math.sqrt(reach)


@inner
def _add_row(equations, w, r):
    """Add one residual of weight w with the Jacobian in ``equations.row``."""
    A, b, J = equations
    for i in range(b.shape[0]):
        b[i] -= w * J[i] * r
        for j in range(i + 1):
            A[i, j] += w * J[i] * J[j]


@inner
def _add_body(equations, body, field, pose, gate):
    """Distances of points to the planes through their nearest samples; returns their weight."""
    samples, normals, J = field.samples, field.normals, equations.row
    points, weights = body
    inv_gate2 = 1.0 / (gate * gate)
    c, s = math.cos(pose[3]), math.sin(pose[3])
    sx, sy, sz = pose[4], pose[5], pose[6]
    total = 0.0
    for n in range(points.shape[0]):
        dx, dy = points[n, 0] - pose[0], points[n, 1] - pose[1]
        ux, uy, uz = c * dx + s * dy, c * dy - s * dx, points[n, 2] - pose[2]
        k = nearest_sample(field, ux / sx, uy / sy, uz / sz)
        if k < 0:
            continue
        ex, ey, ez = ux - sx * samples[k, 0], uy - sy * samples[k, 1], uz - sz * samples[k, 2]
        w = 1.0 - (ex * ex + ey * ey + ez * ez) * inv_gate2
        if w <= 0.0:
            continue
        w = weights[n] * w * w  # Tukey's biweight
        nx, ny, nz = normals[k, 0] / sx, normals[k, 1] / sy, normals[k, 2] / sz
        norm = math.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / norm, ny / norm, nz / norm
        J[0] = -(c * nx - s * ny)
        J[1] = -(s * nx + c * ny)
        J[2] = -nz
        J[3] = nx * uy - ny * ux
        J[4] = -nx * samples[k, 0]
        J[5] = -ny * samples[k, 1]
        J[6] = -nz * samples[k, 2]
        total += w
        _add_row(equations, w, nx * ex + ny * ey + nz * ez)
    return total


@inner
def _add_ground(equations, ground, field, pose, gate, inset, hides):
    """How far ground lies inside the nearest edge of the footprint."""
    edges, J = field.edges, equations.row
    inv_gate2 = 1.0 / (gate * gate)
    c, s = math.cos(pose[3]), math.sin(pose[3])
    sx, sy = pose[4], pose[5]
    for n in range(ground.xyz.shape[0]):
        dx, dy = ground.xyz[n, 0] - pose[0], ground.xyz[n, 1] - pose[1]
        ux, uy = c * dx + s * dy, c * dy - s * dx
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
        J[0] = c * nx - s * ny
        J[1] = s * nx + c * ny
        J[2] = 0.0
        J[3] = ny * ux - nx * uy
        J[4] = nx * edges[e, 0]
        J[5] = ny * edges[e, 1]
        J[6] = 0.0
        _add_row(equations, ground.weights[n] * hides * w * w, r)


@inner
def _add_priors(equations, pose, total, gate, reach, stretch, base):
    """Complete the matrix: damping, the base on the ground, sizes near the stated ones."""
    A, b, _ = equations
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
