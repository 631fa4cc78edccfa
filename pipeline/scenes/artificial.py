"""The artificial scene of [Bovenkamp 2010, section 3.1], made from code.

Four cars of each of two models stand among trees, poles, boxes and a house, one of them under a
tent; points lie on all surfaces, equally many per square metre. Frame ``scene``: metres, z up, the
ground at z = 0, coordinates in whole tenths of a millimetre that float32 holds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from spinpipe.pipeline.scenes import artificial_clutter as clutter
from spinpipe.pipeline.scenes.artificial_cars import COMPACT, SALOON, car_mesh, car_paint
from spinpipe.pipeline.scenes.artificial_clutter import Colour, Item
from spinpipe.schemas.arrays import F64, I32, I64, U8, Mask
from spinpipe.stages.geometry.frames import transform, yaw_matrix
from spinpipe.stages.geometry.shapes import (
    Mesh,
    covered_from_above,
    merged,
    sample_surface,
    surface_area,
)

SEED = 2010
EXTENT_M = 40.0  # side of the square ground
CARS_PER_MODEL = 4
MODEL_POINTS = 25_000  # [Bovenkamp 2010, section 3.1]

_CAR_SHAPES = {"model_1": SALOON, "model_2": COMPACT}
_SHELTERED = 3  # which car stands under the tent: the last one of model 1
_CAR_COLOURS: tuple[Colour, ...] = (
    (178, 34, 40),
    (32, 78, 152),
    (214, 214, 218),
    (236, 184, 40),
    (124, 130, 138),
    (244, 244, 240),
    (24, 112, 100),
    (150, 96, 52),
)
_CRATE_COLOURS: tuple[Colour, ...] = (
    (150, 104, 58),
    (92, 120, 150),
    (196, 160, 100),
    (120, 64, 52),
)


@dataclass(frozen=True, eq=False)
class ModelShape:
    """A car in frame ``object``: mesh (V, 3) and (F, 3), and a cloud (25000, 3) sampled from it."""

    vertices: F64
    faces: I64
    cloud: F64


class TruthRow(NamedTuple):
    """Where a car really stands: its base centre, and where its +x axis points, in ``scene``."""

    model: str
    x: float
    y: float
    z: float
    heading_deg: float  # counter-clockwise from the scene's +x, 0 to 360
    label: int  # the car's number in ``ArtificialScene.labels``


@dataclass(frozen=True, eq=False)
class ArtificialScene:
    """Points (N, 3) float64, colours (N, 3) uint8, labels (N,) int32, models and ground truth.

    Label 0 is the ground, 1 to 8 are the cars in the order of ``truth``, higher ones the rest.
    """

    xyz: F64
    rgb: U8
    labels: I32
    models: Mapping[str, ModelShape]
    truth: tuple[TruthRow, ...]


def make_scene(
    points: int = 250_000,
    noise_m: float = 0.0,
    rng: np.random.Generator | None = None,
    *,
    seen_from: Literal["all", "above"] = "all",
) -> ArtificialScene:
    """Make the scene; the same generator state gives the same bytes.

    Parameters
    ----------
    points : int
        How many points the scene has. Its extent is fixed, so this sets the density: 250,000 are
        about 115 per square metre of surface.
    noise_m : float
        Standard deviation of the Gaussian noise on every coordinate of the scene (not of the
        models), [Bovenkamp 2010, section 3.3]. It changes neither the layout nor the sampling.
    rng : numpy.random.Generator
        By default one with the seed of the scene that ships.
    seen_from : {"all", "above"}
        ``above`` leaves out what a camera straight above does not see [Bovenkamp 2010, section
        3.2]: upright walls and whatever something else covers, the car under the tent too.

    Returns
    -------
    ArtificialScene

    Raises
    ------
    ValueError
        For fewer than one point or negative noise.
    """
    if points < 1 or not noise_m >= 0:
        raise ValueError(f"want points >= 1 and noise_m >= 0, got {points} and {noise_m}")
    rng = np.random.default_rng(SEED) if rng is None else rng
    models = {name: _model(car_mesh(shape), rng) for name, shape in _CAR_SHAPES.items()}
    items = _laid_out(models, _Site(rng, []))
    cloud = _sampled(items, points, rng, from_above=seen_from == "above")
    xyz = cloud.xyz
    if noise_m > 0:
        xyz = xyz + noise_m * rng.standard_normal(xyz.shape)
    truth = tuple(
        TruthRow(item.kind, item.x, item.y, 0.0, item.heading_deg, label)
        for label, item in enumerate(items)
        if item.kind in models
    )
    return ArtificialScene(_stored(xyz), cloud.rgb, cloud.labels, models, truth)


def _model(mesh: Mesh, rng: np.random.Generator) -> ModelShape:
    vertices = _stored(mesh.vertices)
    cloud, _ = sample_surface(vertices, mesh.faces, MODEL_POINTS, rng)
    return ModelShape(vertices, mesh.faces, _stored(cloud))


def _stored(xyz: F64) -> F64:
    """Coordinates as a float32 file holds them.

    Rounding to 0.1 mm first hides the last bits in which machines may differ.
    """
    return np.round(xyz, 4).astype(np.float32).astype(np.float64)


@dataclass
class _Site:
    """Ground that fills up: the discs (x, y, radius) taken, and the generator for the next."""

    rng: np.random.Generator
    taken: list[tuple[float, float, float]]

    def between(self, low: float, high: float) -> float:
        return round(low + (high - low) * float(self.rng.random()), 3)

    def heading_deg(self) -> float:
        return self.between(0, 360) % 360

    def place(self, radius_m: float) -> tuple[float, float]:
        """Take a free disc that lies wholly on the ground, and return its middle."""
        reach = EXTENT_M / 2 - radius_m
        for _ in range(10_000):
            x, y = self.between(-reach, reach), self.between(-reach, reach)
            if all(math.hypot(x - u, y - v) >= radius_m + r for u, v, r in self.taken):
                self.taken.append((x, y, radius_m))
                return x, y
        raise ValueError(f"no room is left for a disc of radius {radius_m} m")


def _laid_out(models: Mapping[str, ModelShape], site: _Site) -> list[Item]:
    """Ground, cars, then the clutter, at random poses whose discs do not overlap.

    Cars keep six metres between their middles and nothing but the posts of the tent comes within
    three: what stands inside the radius of a spin image disturbs it [Bovenkamp 2010, section 4].
    """
    middle = EXTENT_M / 2 - 5.5
    house = clutter.house(site.between(-8, 8), middle)
    site.taken += [(house.x + dx, house.y, 4.1) for dx in (-4.0, 0.0, 4.0)]
    items = [clutter.ground(EXTENT_M)]
    for name, model in models.items():
        for _ in range(CARS_PER_MODEL):
            number = len(items) - 1
            x, y = site.place(4.0 if number == _SHELTERED else 3.0)
            items.append(
                Item(
                    name,
                    Mesh(model.vertices, model.faces),
                    car_paint(_CAR_SHAPES[name], _CAR_COLOURS[number]),
                    x,
                    y,
                    site.heading_deg(),
                    covers_ground=True,
                )
            )
    shelter = items[1 + _SHELTERED]
    items += [house, clutter.tent(shelter.x, shelter.y, shelter.heading_deg)]
    for _ in range(7):
        crown_m = site.between(1.4, 2.1)
        items += clutter.tree(
            *site.place(1.1 * crown_m), site.heading_deg(), crown_m, site.between(1.6, 2.4)
        )
    items += [
        clutter.lamp(*site.place(1.1), site.heading_deg(), site.between(4.5, 6.5)) for _ in range(5)
    ]
    for number in range(8):
        size_m = site.between(0.6, 2.2), site.between(0.5, 1.6), site.between(0.5, 1.5)
        place = site.place(math.hypot(*size_m[:2]) / 2)
        colour = _CRATE_COLOURS[number % len(_CRATE_COLOURS)]
        items.append(clutter.crate(*place, site.heading_deg(), size_m, colour))
    for _ in range(4):
        radius_m = site.between(0.6, 1.0)
        items.append(
            clutter.bush(
                *site.place(1.6 * radius_m), site.heading_deg(), radius_m, site.between(0.8, 1.5)
            )
        )
    items += [clutter.bollard(*site.place(0.15)) for _ in range(8)]
    return items


class _Samples(NamedTuple):
    xyz: F64
    normals: F64
    rgb: U8
    labels: I32

    def at(self, rows: Mask | I64) -> _Samples:
        return _Samples(self.xyz[rows], self.normals[rows], self.rgb[rows], self.labels[rows])


def _joined(parts: Sequence[_Samples]) -> _Samples:
    return _Samples(
        np.concatenate([part.xyz for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.concatenate([part.rgb for part in parts]),
        np.concatenate([part.labels for part in parts]),
    )


def _sampled(
    items: Sequence[Item], points: int, rng: np.random.Generator, *, from_above: bool
) -> _Samples:
    """``points`` points on what shows of the items, equally dense everywhere, in random order."""
    hulls = [Mesh(transform(_pose(item), item.mesh.vertices), item.mesh.faces) for item in items]
    areas = np.array([surface_area(hull) for hull in hulls])
    standing = merged([hull for item, hull in zip(items, hulls, strict=True) if item.covers_ground])
    parts: list[_Samples] = []
    while sum(len(part.labels) for part in parts) < points:
        counts = rng.multinomial(round(1.2 * points) + 100, areas / areas.sum())
        drawn = _joined(
            [_on_item(items, label, int(count), rng) for label, count in enumerate(counts)]
        )
        if from_above:
            seen = ~covered_from_above(drawn.xyz, merged(hulls))
            seen &= drawn.normals[:, 2] > 0.05  # upright walls: not covered, yet not seen
        else:
            seen = np.ones(len(drawn.labels), bool)
            on_ground = drawn.labels == 0
            seen[on_ground] = ~covered_from_above(drawn.xyz[on_ground], standing)
        parts.append(drawn.at(seen))
    cloud = _joined(parts)
    return cloud.at(np.argsort(rng.random(len(cloud.labels)), kind="stable")[:points])


def _pose(item: Item) -> F64:
    return yaw_matrix(item.heading_deg, (item.x, item.y, 0.0))


def _on_item(items: Sequence[Item], label: int, count: int, rng: np.random.Generator) -> _Samples:
    """Points on one item in frame ``scene``, shaded by daylight."""
    item = items[label]
    points, normals = sample_surface(*item.mesh, count, rng)
    colours = item.paint(points, normals)
    if item.roughness_m > 0:
        points = points + item.roughness_m * rng.standard_normal((count, 1)) * normals
    xyz = transform(_pose(item), points)
    normals = transform(yaw_matrix(item.heading_deg), normals)
    sunlit = 0.3 * normals[:, 0] - 0.4 * normals[:, 1] + 0.866 * normals[:, 2]
    light = 0.82 + 0.18 * sunlit + 0.04 * rng.standard_normal(count)
    rgb = np.clip(np.round(colours * light[:, None]), 0, 255).astype(np.uint8)
    return _Samples(xyz, normals, rgb, np.full(count, label, np.int32))
