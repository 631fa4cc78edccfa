"""The hole in the ground below a body: how far it tells where the body stands; compiled."""

from __future__ import annotations

import numpy as np

from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.model.lookup import inside_depth
from spinpipe.stages.verify.model.pose import to_object


@inner
def hides_ground(ground, field, pose, inset):
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
