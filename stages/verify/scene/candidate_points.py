"""The points around a candidate: those of a body that may stand there, and those of the ground."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.compiled import inner
from spinpipe.stages.verify.scene.cell_grid import within

TOO_FEW = 10
"""Fewer points are no body."""
GROUND_POINTS = 400
"""About how many points of the ground tell where it is hidden."""


class Points(NamedTuple):
    """(N, 3) points and (N,) how much surface each stands for."""

    xyz: F64
    weights: F64


@inner
def cut_out(scene, x, y, radius, low, ceiling, count):
    """Points within a horizontal distance: about ``count`` of bodies, some of the ground.

    Parameters
    ----------
    scene : CellGrid, in the frame of the support: z is the height above it.
    radius : metres.
    low : what is no higher than this above the support is ground, metres.
    ceiling : height above which nothing belongs to a body.
    count : how many points of bodies are enough.

    Returns
    -------
    body, ground : Points.
    """
    rows = within(scene, x, y, radius)
    body, ground = _split(scene, rows, low, ceiling)
    return _thin(scene, body, count), _thin(scene, ground, GROUND_POINTS)


@inner
def _split(scene, rows, low, ceiling):
    """Rows that may belong to an object, and rows of the ground."""
    body = np.empty(rows.shape[0], np.int64)
    ground = np.empty(rows.shape[0], np.int64)
    bodies = 0
    grounds = 0
    for row in rows:
        height = scene.points[row, 2]
        if abs(height) <= low:
            ground[grounds] = row
            grounds += 1
        elif 0.0 < height < ceiling:
            body[bodies] = row
            bodies += 1
    return body[:bodies], ground[:grounds]


@inner
def thinned(points, count):
    """About ``count`` of some points, evenly strided, with weights that keep their sum."""
    stride = max(1, (points.xyz.shape[0] + count - 1) // count)
    return Points(points.xyz[::stride].copy(), points.weights[::stride] * stride)


@inner
def _thin(scene, rows, count):
    """About ``count`` of the rows, evenly strided, with weights that keep their sum."""
    stride = max(1, (rows.shape[0] + count - 1) // count)
    n = (rows.shape[0] + stride - 1) // stride
    chosen = np.empty((n, 3))
    weight = np.empty(n)
    for k in range(n):
        chosen[k] = scene.points[rows[k * stride]]
        weight[k] = scene.weights[rows[k * stride]] * stride
    return Points(chosen, weight)
