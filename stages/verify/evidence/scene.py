"""Evidence of the scene's points in the model's bounding box; compiled, see ``evidence``."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.model.lookup import nearest_sample
from spinpipe.stages.verify.model.pose import to_object


class Claim(NamedTuple):
    """Weights of points claimed and explained, and of squared residuals."""

    claimed: float
    explained: float
    square_sum: float
    """Weighted squares of the point-to-plane residuals of the explained points, square metres."""


@inner
def scene_evidence(body, field, pose, gate, free):
    """How much of what the model claims it also explains.

    What lies outside the footprint at a side where something else touches the body belongs to
    that, at least in part, and is left out.

    Parameters
    ----------
    body : Points.
    field : ModelField.
    pose : Pose.
    gate : metres.
    free : (4,) bool, which of the sides front, left, back and right nothing touches.

    Returns
    -------
    Claim
    """
    (points, weights), surface = body, field.surface
    sx, sy, sz = pose.stretch_x, pose.stretch_y, pose.stretch_z
    half_x, half_y = field.size[0] / 2 * sx, field.size[1] / 2 * sy
    top = field.size[2] * sz
    claimed = 0.0
    explained = 0.0
    square_sum = 0.0
    for n in range(points.shape[0]):
        ux, uy, uz = to_object(pose, points[n, 0], points[n, 1], points[n, 2])
        if uz > top + gate or 0.0 <= uz < 0.1 * top:
            continue  # wheels, feet and what the ground piles up against them
        out_x, out_y = abs(ux) - half_x, abs(uy) - half_y
        out = max(out_x, out_y)
        if out > gate or (out > 0.0 and not free[side_of(ux, uy, out_x, out_y)]):
            continue
        k = nearest_sample(field, ux / sx, uy / sy, uz / sz)
        within = out <= 0.0 and uz <= top
        if k < 0:
            # below the base, above the ground: the body goes on where the model does not
            claimed += weights[n] if within else 0.0
            continue
        ex, ey, ez = ux - sx * surface[k, 0], uy - sy * surface[k, 1], uz - sz * surface[k, 2]
        d2 = ex * ex + ey * ey + ez * ez
        if d2 <= gate * gate:
            nx, ny, nz = surface[k, 3] / sx, surface[k, 4] / sy, surface[k, 5] / sz
            r = (nx * ex + ny * ey + nz * ez) ** 2 / (nx * nx + ny * ny + nz * nz)
            claimed += weights[n]
            explained += weights[n]
            square_sum += weights[n] * r
        elif within:
            claimed += weights[n]
    return Claim(claimed, explained, square_sum)


@inner
def side_of(x, y, out_x, out_y):
    """Side beyond which a point lies farther: 0 to 3 for +x, +y, -x and -y."""
    if out_x >= out_y:
        return 0 if x > 0.0 else 2
    return 1 if y > 0.0 else 3


@inner
def root_mean_square(claim):
    """Distance of the explained points to the surface, metres; infinite without any."""
    return math.sqrt(claim.square_sum / claim.explained) if claim.explained > 0.0 else np.inf
