"""The local ground: what is low around each point."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import percentile_filter

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.columns import column_order


def ground_halo_m(sampling: Sampling, reach_m: float) -> float:
    """How far around a place points must be known for ``local_ground`` to be right there."""
    return reach_m + 3.0 * _ground_cell_m(sampling, reach_m)


def _ground_cell_m(sampling: Sampling, reach_m: float) -> float:
    return max(6.0 * sampling.spacing_m, reach_m / 5.0)


def local_ground(xyz: F64, sampling: Sampling, reach_m: float) -> F64:
    """(N,) height of the ground below each of (N, 3) points, world, metres."""
    side = _ground_cell_m(sampling, reach_m)
    order, first, keys, _, cells = column_order(xyz, side)
    counts = np.diff(np.append(first, len(xyz)))
    lowest = np.full(cells[0] * cells[1], np.nan)
    lowest[keys] = xyz[order][first + counts // 20, 2]
    grid = lowest.reshape(cells)
    filled = np.where(np.isnan(grid), np.inf, grid)
    size = 2 * int(np.ceil(reach_m / side)) + 1
    ground = percentile_filter(filled, 5, size=size, mode="constant", cval=np.inf)
    ground = np.where(np.isfinite(ground), ground, np.nanmin(grid))
    column = np.empty(len(xyz), dtype=np.int64)
    column[order] = np.repeat(keys, counts)
    # a twentieth of the points lies about two standard deviations below the surface
    return ground.ravel()[column] + 2.0 * sampling.noise_m
