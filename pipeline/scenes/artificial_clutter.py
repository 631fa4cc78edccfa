"""What stands around the cars of the artificial scene: house, tent, trees, poles, boxes, bushes.

Each item is made in its own frame ``object``: z up, the base centre at the origin, metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F64, U8
from spinpipe.stages.geometry.shapes import (
    Mesh,
    box,
    cylinder,
    ellipsoid,
    extruded,
    merged,
    placed,
    without_underside,
)

Colours = U8
Colour = tuple[int, int, int]
Paint = Callable[[F64, F64], Colours]
"""Maps points (N, 3) and their normals (N, 3) in frame ``object`` to colours (N, 3)."""


@dataclass(frozen=True, eq=False)
class Item:
    """One thing in the scene, upright at (x, y) on the ground and turned by its heading."""

    kind: str
    mesh: Mesh
    paint: Paint
    x: float = 0.0
    y: float = 0.0
    heading_deg: float = 0.0
    covers_ground: bool = False  # stands on its whole base, so that no ground shows under it
    roughness_m: float = 0.0  # standard deviation of the surface along its normal


def plain(colour: Colour) -> Paint:
    """Paint everything in one colour."""
    return lambda points, _normals: np.tile(np.array(colour, np.uint8), (len(points), 1))


def ground(extent_m: float) -> Item:
    """Square of asphalt around the origin with a rim of lawn; slightly rough, as real ground is."""
    half = extent_m / 2
    corners = np.array([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)])

    def paint(points: F64, normals: F64) -> Colours:
        colours = plain((118, 118, 120))(points, normals)
        colours[np.abs(points[:, :2]).max(axis=1) > half - 2.5] = (98, 130, 72)
        return colours

    faces = np.array([(0, 1, 2), (0, 2, 3)])
    return Item("ground", Mesh(corners.astype(np.float64), faces), paint, roughness_m=0.005)


def house(x: float, y: float) -> Item:
    """House of 12 m by 7 m with a gable roof, its long side along the scene's x axis."""
    profile = [(-3.5, 0.0), (3.5, 0.0), (3.5, 3.2), (0.0, 5.2), (-3.5, 3.2)]

    def paint(points: F64, normals: F64) -> Colours:
        along, height = points[:, 1], points[:, 2]
        colours = plain((226, 212, 184))(points, normals)
        window = (np.abs(normals[:, 0]) > 0.9) & (height > 1.0) & (height < 2.3)
        colours[window & (np.mod(along + 0.6, 2.4) < 1.2)] = (70, 86, 104)
        colours[(normals[:, 0] > 0.9) & (np.abs(along) < 0.5) & (height < 2.1)] = (104, 62, 40)
        colours[normals[:, 2] > 0.3] = (156, 74, 56)
        return colours

    mesh = without_underside(extruded(profile, 12.0))
    return Item("house", mesh, paint, x, y, heading_deg=90.0, covers_ground=True)


def tent(x: float, y: float, heading_deg: float) -> Item:
    """Open tent: a gable roof of 5.8 m by 3.4 m on four posts, room for a car below."""
    length, width, eaves, ridge = 5.8, 3.4, 2.1, 2.75
    roof = Mesh(
        np.array(
            [(sx * length / 2, sy * width / 2, ridge if sy == 0 else eaves)
             for sx in (-1, 1) for sy in (-1, 0, 1)]
        ),
        np.array([(0, 3, 4), (0, 4, 1), (1, 4, 5), (1, 5, 2)]),
    )  # fmt: skip
    posts = [
        placed(cylinder(0.04, eaves, 8), (sx * length / 2, sy * width / 2, 0.0))
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]

    def paint(points: F64, normals: F64) -> Colours:
        colours = plain((140, 142, 146))(points, normals)
        stripe = np.where(np.mod(points[:, :1], 1.0) < 0.5, (236, 232, 220), (60, 128, 190))
        cloth = (points[:, 2] >= eaves - 1e-6) & (normals[:, 2] > 0.5) & (normals[:, 2] < 0.999)
        colours[cloth] = stripe[cloth]
        return colours

    return Item("tent", merged([roof, *posts]), paint, x, y, heading_deg)


def tree(x: float, y: float, heading_deg: float, crown_m: float, trunk_m: float) -> list[Item]:
    """Trunk of height ``trunk_m`` and a crown of three ragged clouds of leaves over it."""
    trunk = cylinder(0.16, trunk_m + 0.5 * crown_m, 10, top_radius=0.1)
    clouds = [
        placed(ellipsoid((size * crown_m, size * crown_m, 0.8 * size * crown_m), 12, 6), middle)
        for size, middle in (
            (0.72, (0.28 * crown_m, 0.0, trunk_m)),
            (0.66, (-0.3 * crown_m, 0.2 * crown_m, trunk_m + 0.3 * crown_m)),
            (0.56, (0.0, -0.25 * crown_m, trunk_m + 0.8 * crown_m)),
        )
    ]
    return [
        Item("trunk", trunk, plain((96, 70, 48)), x, y, heading_deg),
        Item("crown", merged(clouds), _foliage((66, 118, 48)), x, y, heading_deg, roughness_m=0.2),
    ]


def bush(x: float, y: float, heading_deg: float, radius_m: float, height_m: float) -> Item:
    """Longish bush of half width ``radius_m``."""
    mesh = ellipsoid((1.5 * radius_m, radius_m, height_m / 2), 14, 7)
    return Item("bush", mesh, _foliage((84, 132, 62)), x, y, heading_deg, roughness_m=0.06)


def lamp(x: float, y: float, heading_deg: float, height_m: float) -> Item:
    """Street lamp: a pole with an arm."""
    arm = placed(box(1.2, 0.25, 0.12), (0.5, 0.0, height_m))
    return Item(
        "pole", merged([cylinder(0.08, height_m, 10), arm]), plain((92, 98, 104)), x, y, heading_deg
    )


def bollard(x: float, y: float) -> Item:
    """Knee-high post."""
    return Item("pole", cylinder(0.1, 0.9, 12), plain((206, 70, 40)), x, y)


def crate(
    x: float, y: float, heading_deg: float, size_m: tuple[float, float, float], colour: Colour
) -> Item:
    """Crate of length, width and height ``size_m``."""
    mesh = without_underside(box(*size_m))
    return Item("box", mesh, plain(colour), x, y, heading_deg, covers_ground=True)


def _foliage(colour: Colour) -> Paint:
    """Green that grows lighter upwards."""

    def paint(points: F64, _normals: F64) -> Colours:
        low, high = points[:, 2].min(initial=0.0), points[:, 2].max(initial=1.0)
        light = 0.75 + 0.4 * (points[:, 2:] - low) / (high - low)
        return (np.array(colour) * light).astype(np.uint8)

    return paint
