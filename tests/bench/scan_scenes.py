"""The scenes of the scan's benchmarks, in blocks: memory does not grow with the scene.

``artificial``: the paper's, with ground that is exactly level, so that ground points do not see
each other; ``artificial 5 mm``: the same with rough ground, as it ships; ``artificial 5 cm``: with
noise; ``ground``: level ground at 1000 points per square metre with 3 cm noise; ``street``: cars
between dense facades, trees and bushes at 1000 points per square metre with 2 cm noise.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from spinpipe.pipeline.scenes.artificial import SEED, make_scene
from spinpipe.pipeline.scenes.artificial_cars import SALOON, car_mesh
from spinpipe.pipeline.scenes.artificial_clutter import bush, tree
from spinpipe.stages.geometry.shapes import Mesh, box, placed, sample_surface, surface_area
from spinpipe.stages.scan.image import SpinGrid
from spinpipe.stages.scan.templates import Templates, object_image

GRID = SpinGrid.of(2.5, 1.0, 0.1)
DENSITY = 1000
BLOCK_POINTS = 2_000_000
LENGTH_M, WIDTH_M, FACADE_M = 36.0, 14.0, 9.0  # of the street
CARS = 8
LEAVES_M = 0.15

Cloud = NDArray[np.float32]


def ground_blocks(points: int) -> Iterator[tuple[Cloud, Cloud]]:
    """Blocks of level ground in a row along x: points with halo, and the block's own."""
    own = min(points, BLOCK_POINTS)
    count, side = round(points / own), (own / DENSITY) ** 0.5

    def block(number: int) -> Cloud:
        rng = np.random.default_rng(number)
        cloud = rng.random((own, 3), np.float32) * np.float32([side, side, 0])
        cloud[:, 0] += number * side
        cloud[:, 2] = rng.normal(0, 0.03, own)
        return cloud

    before = np.zeros((0, 3), np.float32)
    this = block(0)
    for number in range(count):
        after = block(number + 1) if number + 1 < count else np.zeros((0, 3), np.float32)
        left, right = number * side - GRID.radius_m, (number + 1) * side + GRID.radius_m
        halo = [before[before[:, 0] > left], this, after[after[:, 0] < right]]
        yield np.concatenate(halo), this
        before, this = this, after


def scene_blocks(scene: str, points: int) -> Iterator[tuple[Cloud, Cloud]]:
    """Blocks of a scene, see ``ground_blocks``."""
    if scene == "ground":
        yield from ground_blocks(points)
        return
    if scene == "street":
        cloud, _ = street(DENSITY, 0.02)
    else:
        noise_m = 0.05 if scene == "artificial 5 cm" else 0.0
        made = make_scene(points, noise_m, np.random.default_rng(SEED))
        cloud = made.xyz.astype(np.float32)
        if scene == "artificial":
            cloud[made.labels == 0, 2] = 0.0
    yield cloud, cloud


def model_template() -> Templates:
    """Template of the artificial scene's first car."""
    scene = make_scene(20_000, 0.0, np.random.default_rng(SEED))
    return Templates.of(GRID, [object_image(scene.models["model_1"].cloud, GRID)])


def street(
    density: float, noise_m: float, seed: int = 0
) -> tuple[NDArray[np.float32], list[tuple[float, float]]]:
    """Points (N, 3) of a street with facades on both sides, and where its cars (x, y) stand.

    Parameters
    ----------
    density : points per square metre of every surface.
    noise_m : standard deviation of the noise on every coordinate.
    """
    rng = np.random.default_rng(seed)
    ground = box(LENGTH_M, WIDTH_M, 0.01)
    meshes: list[tuple[Mesh, float]] = [(placed(ground, (0, 0, -0.01)), 0.0)]
    for side in (-1, 1):
        y = side * (WIDTH_M / 2 + 0.15)
        meshes.append((placed(box(LENGTH_M, 0.3, FACADE_M), (0, y, 0)), 0.01))
        for x in np.arange(-LENGTH_M / 2 + 2, LENGTH_M / 2 - 1, 3.0):  # sills, doors, balconies
            for z in (1.0, 4.0, 7.0):
                meshes.append((placed(box(1.4, 0.25, 0.1), (x, y - side * 0.25, z)), 0.0))
    car = car_mesh(SALOON)
    places: list[tuple[float, float]] = []
    for k, x in enumerate(np.linspace(-14, 14, CARS)):
        y = 4.4 if k % 2 else -4.4
        heading_deg = float(rng.uniform(-6, 6)) + (180.0 if k % 3 == 0 else 0.0)
        meshes.append((placed(car, (x, y, 0), heading_deg), 0.0))
        places.append((float(x), y))
    for k, x in enumerate(np.linspace(-12, 12, 6)):
        y = 6.0 if k % 2 else -6.0
        for item in [*tree(0, 0, 0, 1.8, 2.4), bush(0, 0, 0, 0.8, 1.2)]:
            roughness_m = LEAVES_M if item.roughness_m > 0 else 0.0
            meshes.append((placed(item.mesh, (x, y, 0)), roughness_m))
    parts = []
    for mesh, roughness_m in meshes:
        points, normals = sample_surface(*mesh, round(surface_area(mesh) * density), rng)
        parts.append(points + roughness_m * rng.standard_normal((len(points), 1)) * normals)
    cloud = np.concatenate(parts)
    cloud = cloud[cloud[:, 2] > -0.005]
    return (cloud + noise_m * rng.standard_normal(cloud.shape)).astype(np.float32), places
