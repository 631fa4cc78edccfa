"""The two passenger cars of the artificial scene: a saloon and a tall compact car.

Frame ``object``: x forwards, y to the left, z up, metres; the base centre (middle of the horizontal
bounding box, on the lowest height) is the origin. Only the outer shell: no underside, no inside.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spinpipe.pipeline.scenes.artificial_clutter import Colour, Colours, Paint, plain
from spinpipe.schemas.arrays import F64
from spinpipe.stages.geometry.shapes import (
    Mesh,
    extruded,
    face_areas_and_normals,
    lofted,
    merged,
    without_underside,
)


class CarShape(NamedTuple):
    """A car body as cross-sections from tail to nose, and its wheels; metres.

    ``stations`` holds (x, height of the middle line, half width at the shoulder) from tail to nose.
    Where the middle line rises above ``belt_m`` the section carries the cabin.
    """

    stations: tuple[tuple[float, float, float], ...]
    belt_m: float  # where the windows begin
    roof_inset_m: float  # how much narrower than the shoulders the roof is, each side
    roof_arch_m: float  # how much lower than its middle the roof's edge is
    axles_m: tuple[float, float]
    pillars_m: tuple[float, ...]
    wheel_radius_m: float = 0.31
    floor_m: float = 0.2


SALOON = CarShape(
    stations=(
        (-2.26, 0.62, 0.66),
        (-2.20, 0.93, 0.78),
        (-1.72, 0.99, 0.86),
        (-1.00, 1.34, 0.88),
        (-0.55, 1.40, 0.89),
        (-0.10, 1.45, 0.89),
        (0.35, 1.39, 0.89),
        (1.14, 0.97, 0.88),
        (1.80, 0.84, 0.85),
        (2.18, 0.70, 0.76),
        (2.26, 0.52, 0.64),
    ),
    belt_m=0.9,
    roof_inset_m=0.3,
    roof_arch_m=0.06,
    axles_m=(-1.33, 1.36),
    pillars_m=(-0.95, -0.05),
)

COMPACT = CarShape(
    stations=(
        (-1.93, 0.60, 0.68),
        (-1.88, 1.00, 0.80),
        (-1.62, 1.50, 0.84),
        (-1.30, 1.58, 0.85),
        (-0.40, 1.62, 0.86),
        (0.30, 1.60, 0.86),
        (0.60, 1.53, 0.86),
        (1.30, 1.04, 0.85),
        (1.72, 0.90, 0.80),
        (1.90, 0.70, 0.72),
        (1.93, 0.52, 0.64),
    ),
    belt_m=0.95,
    roof_inset_m=0.14,
    roof_arch_m=0.03,
    axles_m=(-1.22, 1.28),
    pillars_m=(-1.25, -0.25, 0.75),
)


def car_mesh(shape: CarShape) -> Mesh:
    """Outer shell of a car in frame ``object``: body, cabin and the visible parts of the wheels."""
    body = lofted([_section(shape, *station) for station in shape.stations])
    width = max(half for _, _, half in shape.stations)
    wheels = [_wheel(shape, x, side * width) for x in shape.axles_m for side in (-1, 1)]
    return merged([without_underside(body), *wheels])


def car_paint(shape: CarShape, body: Colour) -> Paint:
    """Paint for a car: body colour, glass, tyres and rims, head and tail lights."""
    tail, nose = shape.stations[0][0], shape.stations[-1][0]
    roof = max(top for _, top, _ in shape.stations)

    def paint(points: F64, normals: F64) -> Colours:
        x, y, z = points.T
        colours = plain(body)(points, normals)
        pillar = np.min([np.abs(x - pillar) for pillar in shape.pillars_m], axis=0) < 0.05
        pillar &= np.abs(normals[:, 1]) > 0.5
        # Roofs lie flat, windscreens do not
        upright = (normals[:, 2] < 0.94) & (z > shape.belt_m + 0.03) & (z < roof - 0.08)
        colours[upright & ~pillar] = (38, 48, 56)
        outside = np.abs(y) > 0.42
        colours[outside & (x > nose - 0.14) & (z > 0.54) & (z < 0.72)] = (250, 244, 214)
        colours[outside & (x < tail + 0.1) & (z > 0.64) & (z < 0.86)] = (186, 24, 24)
        for axle in shape.axles_m:
            reach = np.hypot(x - axle, z - shape.wheel_radius_m) / shape.wheel_radius_m
            colours[(reach < 1.02) & (np.abs(y) > 0.5)] = (26, 26, 28)
            colours[(reach < 0.6) & (np.abs(y) > 0.5)] = (168, 170, 174)
        return colours

    return paint


def _section(shape: CarShape, x: float, top: float, half: float) -> F64:
    """Cross-section (9, 3) at ``x``, counter-clockwise seen from the front."""
    belt = min(shape.belt_m, top - 0.06)
    cabin = min(1.0, max(0.0, (top - shape.belt_m) / 0.35))  # 0 bonnet or boot, 1 full cabin
    edge = top - (0.03 + cabin * (shape.roof_arch_m - 0.03))
    inset = 0.1 + cabin * (shape.roof_inset_m - 0.1)
    left = [
        (half - 0.06, shape.floor_m),
        (half, min(0.55, belt - 0.02)),
        (half - 0.03, belt),
        (half - inset, edge),
    ]
    outline = [*left, (0.0, top), *((-y, z) for y, z in reversed(left))]
    return np.array([(x, y, z) for y, z in outline])


def _wheel(shape: CarShape, axle: float, side: float) -> Mesh:
    """Wheel in frame ``object``: its outer face, and of the rest what shows below the floor."""
    radius, sides = shape.wheel_radius_m, 24
    # A half step of turn puts a flat on the ground, the lowest height then is exactly 0
    angles = [2 * math.pi * (step + 0.5) / sides - math.pi / 2 for step in range(sides)]
    apothem = math.cos(math.pi / sides)
    rim = [
        (axle + radius * math.cos(angle), radius * (1 + math.sin(angle) / apothem))
        for angle in angles
    ]
    tyre = extruded(rim, 0.2)
    outwards = math.copysign(1.0, side)
    vertices = tyre.vertices + np.array([0.0, side - outwards * 0.09, 0.0])
    _, normals = face_areas_and_normals(vertices, tyre.faces)
    middles = vertices[tyre.faces].mean(axis=1)
    shows = (normals[:, 1] * outwards > 0.5) | (middles[:, 2] < shape.floor_m)
    return Mesh(vertices, tyre.faces[shows & (normals[:, 1] * outwards > -0.5)])
