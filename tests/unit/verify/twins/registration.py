"""Plain twins of the registration: one step of it, and whether a course follows them."""

from __future__ import annotations

import math

import numpy as np
from tests.unit.verify.twins.scene import depths, look_up, off_surface, to_object, total

from spinpipe.stages.verify.fit import registration
from spinpipe.stages.verify.judge.kernels import FINE_POINTS
from spinpipe.stages.verify.scene.candidate_points import Points


def step(body, ground, field, pose, gate, inset, hides, stretch, base):
    """The pose after one Gauss-Newton step, and how far it would move; None if nothing is near."""
    c, s = math.cos(pose[3]), math.sin(pose[3])
    scale = pose[4:]
    u = to_object(pose, body.xyz)
    k, offset, n = off_surface(field, pose, u)
    w = 1 - (offset**2).sum(axis=1) / gate**2
    near = (k >= 0) & (w > 0)
    rows = np.column_stack(
        [
            s * n[:, 1] - c * n[:, 0],
            -s * n[:, 0] - c * n[:, 1],
            -n[:, 2],
            n[:, 0] * u[:, 1] - n[:, 1] * u[:, 0],
            -n * field.surface[k, :3],
        ]
    )
    r = (n * offset).sum(axis=1)
    w = body.weights * np.maximum(w, 0) ** 2  # Tukey's biweight
    terms = [(rows[near], r[near], w[near])]
    mass = w[near].sum()
    if mass <= 0:
        return None
    if hides >= 0.5:
        v = to_object(pose, ground.xyz)[:, :2]
        e = look_up(field.depth_edge, field, v / scale[:2])
        m = field.edges[e, 2:] / scale[:2]
        m /= np.linalg.norm(m, axis=1, keepdims=True)
        r = (m * (scale[:2] * field.edges[e, :2] - v)).sum(axis=1) - inset
        held = (e >= 0) & (r > 0) & (r < gate)
        rows = np.zeros((len(v), 7))
        rows[:, 0], rows[:, 1] = c * m[:, 0] - s * m[:, 1], s * m[:, 0] + c * m[:, 1]
        rows[:, 3] = m[:, 1] * v[:, 0] - m[:, 0] * v[:, 1]
        rows[:, 4:6] = m * field.edges[e, :2]
        w = ground.weights * hides * (1 - (r / gate) ** 2) ** 2
        terms.append((rows[held], r[held], w[held]))
    # damping and priors are residuals too, one for each number of the pose
    damp = 1e-4 * mass * np.array([1, 1, 1, field.outermost_m**2, 1, 1, 1])
    level = mass * np.array([0, 0, 0.1 * min(1.0, (gate / base.sd) ** 2) if base.sd > 0 else 0])
    size = 0.02 * mass * (gate / stretch) ** 2 if stretch > 0 else 0.0
    terms.append((np.eye(7), np.zeros(7), damp))
    terms.append((np.eye(7)[:3], pose[:3] - base.z, level))
    terms.append((np.eye(7)[4:], scale - 1, np.full(3, size)))
    rows, r, w = (np.concatenate(parts) for parts in zip(*terms, strict=True))
    dof = 7 if stretch > 0 else 4
    J = rows[:, :dof]
    A, b = (J.T * w) @ J, -(J.T * w) @ r
    delta = np.linalg.solve(A, b)
    moved = max(np.linalg.norm(delta[:3]), abs(delta[3]) * field.outermost_m)
    after = pose.copy()
    after[:dof] += min(1.0, gate / moved) * delta if moved > 0 else 0.0
    if stretch > 0:
        after[4:] = np.clip(after[4:], 1 - stretch, 1 + stretch)
    return after, moved


def hides_ground(ground, field, pose, inset):
    """How much less ground is seen well inside the footprint than around it, 0..1."""
    depth = depths(field, to_object(pose, ground.xyz)[:, :2] / pose[4:6])
    inside, outside = depth > inset, (depth < 0) & (depth > -np.inf)
    areas = (field.depths > inset).sum(), (field.depths < 0).sum()
    seen = total(ground.weights[inside]), total(ground.weights[outside])
    if seen[1] <= 0 or 0 in areas:
        return 0.0
    return max(0.0, 1 - (seen[0] / areas[0]) / (seen[1] / areas[1]))


def follow(body, ground, field, limits, course):
    """Largest distance of each pose (I, 7) of a course from where a step from the last one leads.

    And the number of steps that there should be; from every pose the twin goes on by itself, so
    errors do not add up.
    """
    coarse, fine = limits.coarse_gate_m, limits.gate_m
    base = registration.Base(0.0, fine if limits.stretch > 0 else 0.0)
    off, at = 0.0, 0
    first = registration.FIRST_POINTS
    gates = ((coarse, first), (math.sqrt(coarse * fine), 2 * first), (fine, FINE_POINTS))
    for number, (gate, most) in enumerate(gates):
        settled = registration.SETTLED[number == len(gates) - 1]
        stride = max(1, -(-len(body.xyz) // most))
        some = Points(body.xyz[::stride], body.weights[::stride] * stride)
        hides = hides_ground(ground, field, course[at], gate + 0.5 * fine)
        for _ in range(registration.STEPS):
            made = step(
                some, ground, field, course[at], gate, 0.5 * fine, hides, limits.stretch, base
            )
            if made is None or at + 1 == len(course):
                return off, at
            at += 1
            off = max(off, np.abs(made[0] - course[at]).max())
            if made[1] < settled * gate:
                break
    return off, at
