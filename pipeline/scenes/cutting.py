"""A model cut from a scene: what stands in an upright box around one instance, without ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spinpipe.pipeline.scenes.ground_grid import GroundGrid, ground_grid, ground_spread
from spinpipe.schemas.arrays import F64, I64
from spinpipe.stages.geometry.frames import inverse, transform, yaw_matrix

CELLS_ACROSS = 8
"""Cells of the local ground across the narrow side of the box."""
GROUND_SHARE = 0.05
"""Least height above the ground that is kept, as a share of the box's height: what lies lower
cannot be told from uneven ground."""
MOST_GROUND_SHARE = 0.15
"""Greatest height that still is taken for uneven ground, as a share of the box's height."""


def around_box(centre: F64, size: F64) -> tuple[F64, F64]:
    """Corners (2,) and (2,) of a square that shows the ground around a box wherever it is turned.

    Parameters
    ----------
    centre : (2,) of the box, metres.
    size : (3,) length, width, height.
    """
    reach = 1.5 * float(np.hypot(size[0], size[1]))
    return centre - reach, centre + reach


def cut_instance(
    points: NDArray[np.floating],
    centre: F64,
    size: F64,
    heading_deg: float,
    base_z: float | None = None,
) -> tuple[I64, F64]:
    """Points of one instance in its object frame.

    Parameters
    ----------
    points : (N, 3) world, all that stands within ``around_box``.
    centre : (2,) middle of the box, world, metres.
    size : (3,) length, width, height.
    heading_deg : direction of the length, counter-clockwise from the world's +x.
    base_z : height of the box's underside; by default that of the ground around it.

    Returns
    -------
    rows : (M,) int64
        Which points belong to the instance.
    T_world_object : (4, 4)
        Pose of the object frame: middle of the box's underside, x along its length.
    """
    low, high = around_box(centre, size)
    grid = ground_grid(
        [points],
        low,
        high,
        cell_m=float(min(size[:2])) / CELLS_ACROSS,
        window_m=2.0 * float(max(size[:2])),
        step_m=0.25 * float(size[2]),
    )
    pose = yaw_matrix(heading_deg, np.append(centre, base_z or 0.0))
    if base_z is None:
        pose[2, 3] = _ground_below(grid, pose, size)
    in_object = transform(inverse(pose), points)
    inside = np.all(np.abs(in_object[:, :2]) <= size[:2] / 2, axis=1) & (in_object[:, 2] <= size[2])
    above_ground = points[:, 2] - grid.heights(points[:, :2])
    height = float(size[2])
    # A quarter of what is near the ground may be the skin that photogrammetry spans to objects
    clear_m = ground_spread(
        grid, [points], GROUND_SHARE * height, MOST_GROUND_SHARE * height, share=0.75
    )
    inside &= np.minimum(above_ground, in_object[:, 2]) > clear_m
    return np.flatnonzero(inside), pose


def _ground_below(grid: GroundGrid, pose: F64, size: F64) -> float:
    """Middle height of the ground seen next to the box, else of what lies below it."""
    x, y = np.meshgrid(*(np.arange(n) for n in grid.height.shape), indexing="ij")
    middles = grid.low + grid.cell_m * (np.stack([x.ravel(), y.ravel()], axis=1) + 0.5)
    offset = transform(inverse(pose), np.column_stack([middles, np.zeros(len(middles))]))
    outside = np.max(np.abs(offset[:, :2]) - size[:2] / 2, axis=1)
    beside = (outside > 0) & (outside < min(size[:2]) / 2) & grid.seen.ravel()
    heights = grid.height.ravel()[beside]
    return float(np.median(heights)) if len(heights) else float(grid.heights(pose[None, :2, 3])[0])
