"""Places of a scene where an object could stand: on seen ground, clear of what rises from it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinpipe.pipeline.scenes.ground_grid import GroundGrid
from spinpipe.schemas.arrays import F64, I64, Mask

TRIES = 2000
"""Random poses that are tried for each object before the scene counts as full."""
LEAST_SEEN = 0.75
"""Share of the ground below an object that must be seen: where the scene ends or has a hole nobody
would label the rest of a thing. Chosen."""


@dataclass(frozen=True)
class Footprint:
    """Horizontal rectangle in the object frame and the height above it."""

    length_m: float
    width_m: float
    height_m: float


@dataclass(frozen=True)
class Place:
    """An upright pose on the ground, world frame."""

    x: float
    y: float
    heading_deg: float
    footprint: Footprint


def blocked_cells(
    grid: GroundGrid, pieces: Iterable[NDArray[np.floating]], clear_m: float, height_m: float
) -> Mask:
    """Cells (X, Y) in which something rises above the ground.

    Parameters
    ----------
    grid : the local ground.
    pieces : (N, 3) points of the world each.
    clear_m : up to this height points belong to the ground.
    height_m : above this height there is room for the object below; what hangs there may hide it.

    Two points make an obstacle: one may be a stray.
    """
    counts = np.zeros(grid.height.shape, np.int64)
    for xyz in pieces:
        cells, inside = grid.cells(xyz[:, :2])
        above = xyz[:, 2] - grid.height[cells[:, 0], cells[:, 1]]
        rising = inside & (above > clear_m) & (above < height_m)
        np.add.at(counts, (cells[rising, 0], cells[rising, 1]), 1)
    return counts >= 2


def free_places(
    grid: GroundGrid,
    blocked: Mask,
    footprints: Sequence[Footprint],
    gap_m: float,
    rng: np.random.Generator,
) -> list[Place]:
    """Random places for objects, uniform over the seen ground and all headings.

    Parameters
    ----------
    grid : the local ground.
    blocked : (X, Y) cells where something stands.
    footprints : of the objects to place, in order.
    gap_m : least distance to what stands there and between the objects.
    rng : decides.

    Returns
    -------
    list of Place
        One for each footprint, fewer when there is no room left.
    """
    ground = np.argwhere(grid.seen & ~blocked)
    taken = blocked.copy()
    places: list[Place] = []
    for footprint in footprints:
        for place in _random_places(grid, ground, footprint, rng):
            whole, inside_whole = grid.cells(_points_over(place, gap_m, grid.cell_m))
            if np.any(taken[whole[:, 0], whole[:, 1]] & inside_whole):
                continue
            below, inside = grid.cells(_points_over(place, 0.0, grid.cell_m))
            seen = grid.seen[below[:, 0], below[:, 1]] & inside
            if seen.mean() >= LEAST_SEEN:
                taken[below[inside, 0], below[inside, 1]] = True
                places.append(place)
                break
    return places


def _random_places(
    grid: GroundGrid, ground: I64, footprint: Footprint, rng: np.random.Generator
) -> Iterator[Place]:
    if not len(ground):
        return
    for _ in range(TRIES):
        cell = ground[rng.integers(len(ground))]
        x, y = grid.low + grid.cell_m * (cell + rng.random(2))
        yield Place(float(x), float(y), float(360.0 * rng.random()), footprint)


def _points_over(place: Place, margin_m: float, cell_m: float) -> F64:
    """Points (N, 2) that miss no cell below the footprint widened by a margin."""
    axes = [
        np.linspace(-reach, reach, int(np.ceil(4 * reach / cell_m)) + 1)
        for reach in (
            place.footprint.length_m / 2 + margin_m,
            place.footprint.width_m / 2 + margin_m,
        )
    ]
    along, across = (v.ravel() for v in np.meshgrid(*axes))
    cos, sin = np.cos(np.radians(place.heading_deg)), np.sin(np.radians(place.heading_deg))
    return np.column_stack(
        [place.x + cos * along - sin * across, place.y + sin * along + cos * across]
    )
