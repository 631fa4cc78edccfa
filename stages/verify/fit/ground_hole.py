"""The hole in the ground below a body: how far it tells where the body stands; compiled."""

from __future__ import annotations

import math

import numpy as np

from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.model.lookup import inside_depth


@inner
def hides_ground(ground, field, pose, inset):
    """How much less ground is seen well inside the footprint than around it, 0..1.

    Near 1 the outline of the hole in the ground shows where the body stands, even one that returns
    next to no points itself; near 0 the scene shows what is below things too.
    """
    area_inside, area_outside = _areas(field, inset)
    c, s = math.cos(pose[3]), math.sin(pose[3])
    inside = 0.0
    outside = 0.0
    for n in range(ground.xyz.shape[0]):
        dx, dy = ground.xyz[n, 0] - pose[0], ground.xyz[n, 1] - pose[1]
        ux, uy = (c * dx + s * dy) / pose[4], (c * dy - s * dx) / pose[5]
        depth = inside_depth(field, ux, uy)
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
