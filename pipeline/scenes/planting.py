"""Objects put into a scene as if they had been there when it was reconstructed.

A planted object takes on the density, the noise and the gaps of the ground that it stands on, and
hides the ground below it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from spinpipe.pipeline.scenes.free_places import Place
from spinpipe.pipeline.scenes.ground_grid import GroundGrid
from spinpipe.schemas.arrays import F64, Mask
from spinpipe.schemas.records import ObjectModel
from spinpipe.stages.geometry.frames import inverse, transform, yaw_matrix
from spinpipe.stages.geometry.seen_from_above import FaceGrid, seen_from_above
from spinpipe.stages.geometry.shapes import Mesh, sample_surface, surface_area, without_underside

OVERSAMPLING = 4
"""Candidates drawn for each point of a planted mesh."""
DENSITY_NEIGHBOURS = 8
"""Neighbours that tell the density and the normal of a cloud."""
OBLIQUE = 0.1
"""Cosine below which a surface still is seen a little: photos from above are not all straight."""
MIN_GROUND_POINTS = 20
"""Fewer points of the ground tell neither its slope nor its noise."""


@dataclass(frozen=True)
class Surroundings:
    """What the ground around a place is like."""

    density: float
    """Points per square metre of ground."""
    noise_m: float
    """Robust standard deviation of the ground points about their plane."""
    base_z: float
    """Height of that plane at the place, world."""


@dataclass(frozen=True)
class VisibleSurface:
    """Points on an object's surface that a sensor may see, in the object frame."""

    points: F64
    """(N, 3) metres."""
    area_m2: F64
    """(N,) area that each point stands for, as the sensor sees it."""
    from_above: bool


@dataclass(frozen=True)
class Plant:
    """A planted object."""

    T_world_object: F64
    points: F64
    """(N, 3) world."""
    visibility: float
    """Share of the surface that nothing in the scene hides."""
    surroundings: Surroundings
    top: F64
    """(X, Y) highest point of the object over a grid in the object frame; -inf beside it."""
    top_low: F64
    top_cell_m: float

    def hides(self, points: NDArray[np.floating]) -> Mask:
        """Which points (N, 3) of the world lie below the object's surface."""
        T = self.T_world_object
        reach = float(np.abs(self.top_low).max()) * 2**0.5 + self.top_cell_m
        hidden = np.all(np.abs(points[:, :2] - T[:2, 3]) <= reach, axis=1)
        near = transform(inverse(T), points[hidden])
        cell = np.floor((near[:, :2] - self.top_low) / self.top_cell_m).astype(np.int64)
        shape = np.array(self.top.shape)
        over = np.all((cell >= 0) & (cell < shape), axis=1)
        cell = np.clip(cell, 0, shape - 1)
        hidden[hidden] = over & (near[:, 2] < self.top[cell[:, 0], cell[:, 1]])
        return hidden


def look_around(
    points: NDArray[np.floating], grid: GroundGrid, place: Place, clear_m: float
) -> Surroundings:
    """Measure the ground around a place.

    Parameters
    ----------
    points : (N, 3) world, at least those within the footprint's half diagonal and a cell.
    grid : the local ground.
    place : where.
    clear_m : up to this height points belong to the ground.

    Raises
    ------
    ValueError
        If too little ground is there.
    """
    footprint = place.footprint
    radius = float(np.hypot(footprint.length_m, footprint.width_m)) / 2
    offset = points[:, :2].astype(np.float64) - np.array([place.x, place.y])
    cells, inside = grid.cells(points[:, :2])
    height = points[:, 2] - grid.height[cells[:, 0], cells[:, 1]]
    # Whole cells, so that their number gives the area
    middles = grid.low + grid.cell_m * (cells + 0.5) - np.array([place.x, place.y])
    near = np.hypot(middles[:, 0], middles[:, 1]) < radius
    ground = inside & near & (np.abs(height) < clear_m)
    if ground.sum() < MIN_GROUND_POINTS:
        raise ValueError(f"only {ground.sum()} points of ground around the place")
    xy, z = offset[ground], points[ground, 2].astype(np.float64)
    design = np.column_stack([xy, np.ones(len(xy))])
    plane, noise_m = _fit(design, z)
    for _ in range(2):
        keep = np.abs(z - design @ plane) <= 3.0 * noise_m + 1e-9
        plane, noise_m = _fit(design[keep], z[keep])
    seen = len(np.unique(cells[ground] @ [grid.height.shape[1], 1]))
    return Surroundings(
        density=float(ground.sum()) / (seen * grid.cell_m**2),
        noise_m=noise_m,
        base_z=float(plane[2]),
    )


def _fit(design: F64, z: F64) -> tuple[F64, float]:
    """Least squares and the robust standard deviation of its residuals (1.4826 MAD)."""
    plane = np.asarray(np.linalg.lstsq(design, z, rcond=None)[0], np.float64)
    return plane, 1.4826 * float(np.median(np.abs(z - design @ plane)))


def visible_surface(model: ObjectModel, density: float, rng: np.random.Generator) -> VisibleSurface:
    """Points on the part of a model's surface that photos show.

    From above a surface gets points in proportion to how much of it the sensor sees: the cosine
    of its slope.

    Parameters
    ----------
    model : its mesh, or its cloud where there is none.
    density : points per square metre that the surface must have to spare.
    """
    from_above = model.visible_from == "above"
    if len(model.faces):
        mesh = without_underside(
            Mesh(model.vertices.astype(np.float64), model.faces.astype(np.int64))
        )
        area = surface_area(mesh)
        count = int(np.ceil(OVERSAMPLING * density * area))
        points, normals = sample_surface(*mesh, count, rng)
        areas = np.full(count, area / count)
        upward = np.abs(normals[:, 2])
        if from_above:
            open_above = seen_from_above(points, FaceGrid.of(mesh))
            points, areas, upward = points[open_above], areas[open_above], upward[open_above]
    else:
        points = model.points.astype(np.float64)
        areas, upward = _areas_and_slopes(points)
    if from_above:
        areas = areas * np.maximum(upward, OBLIQUE)
    return VisibleSurface(points, areas, from_above)


def _areas_and_slopes(points: F64) -> tuple[F64, F64]:
    """Area that each point of a cloud stands for, and the upward part of its normal (N,), (N,)."""
    distance, rows = KDTree(points).query(points, k=min(DENSITY_NEIGHBOURS + 1, len(points)))
    areas = np.pi * distance[:, -1] ** 2 / (distance.shape[1] - 1)
    around = points[rows] - points[rows].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    return areas, np.abs(axes[:, 2, 0])


def plant(
    surface: VisibleSurface,
    place: Place,
    around: Surroundings,
    scene: NDArray[np.floating],
    grid: GroundGrid,
    rng: np.random.Generator,
) -> Plant:
    """Put an object's surface into the scene.

    Thinned to the density around it; seen only where the ground below was seen and, from above,
    where nothing hangs over it; moved by the noise around it.

    Parameters
    ----------
    surface : of the object, in the object frame.
    place, around : where, and what the ground is like there.
    scene : (N, 3) world, at least what stands over the place.
    grid : the local ground.
    """
    pose = yaw_matrix(place.heading_deg, np.array([place.x, place.y, around.base_z]))
    world = transform(pose, surface.points)
    overhead = _overhead(scene, grid, place) if surface.from_above else scene[:0]
    seen = _seen(world, overhead, grid)
    share = np.minimum(around.density * surface.area_m2, 1.0)
    kept = seen & (rng.random(len(world)) < share)
    points = world[kept] + around.noise_m * rng.standard_normal((int(kept.sum()), 3))
    top, low = _top_of(surface.points, grid.cell_m)
    visibility = float(surface.area_m2[seen].sum() / surface.area_m2.sum())
    return Plant(pose, points, visibility, around, top, low, grid.cell_m)


def _overhead(scene: NDArray[np.floating], grid: GroundGrid, place: Place) -> NDArray[np.floating]:
    """What hangs over the object."""
    return scene[scene[:, 2] - grid.heights(scene[:, :2]) > place.footprint.height_m]


def _seen(world: F64, overhead: NDArray[np.floating], grid: GroundGrid) -> Mask:
    """Which points of the object stand over seen ground and under nothing."""
    cells, inside = grid.cells(world[:, :2])
    seen = inside & grid.seen[cells[:, 0], cells[:, 1]]
    above, within = grid.cells(overhead[:, :2])
    columns = grid.height.shape[1]
    covered = np.unique(above[within] @ [columns, 1])
    return seen & ~np.isin(cells @ [columns, 1], covered)


def _top_of(points: F64, cell_m: float) -> tuple[F64, F64]:
    """Highest point over each cell of a grid around the object, and the grid's least corner."""
    reach = np.abs(points[:, :2]).max(axis=0) + cell_m
    shape = np.ceil(2 * reach / cell_m).astype(int)
    top = np.full(shape, -np.inf)
    cell = ((points[:, :2] + reach) / cell_m).astype(np.int64)
    np.maximum.at(top, (cell[:, 0], cell[:, 1]), points[:, 2])
    return top, -reach
