"""Generic vehicles as triangle meshes, generated from a handful of sections.

Each vehicle is a loft: hexagonal cross-sections (sill, belt line, roof line) at stations along the
object's x axis, front at +x. Dimensions are those of ordinary cars of each kind, rounded; none was
fitted to a scene. One rigid saloon does not cover a car park: pass several of these as models and
let each stretch within bounds while it is fitted.
"""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.geometry.shapes import Mesh, extruded, lofted, merged, placed

# Sections from tail to nose: (x, belt half-width, sill z, belt z, top half-width, top z), metres.
# Where the top lies on the belt (a bonnet) the upper part of the section is nearly flat.
_Section = tuple[float, float, float, float, float, float]

_SALOON: tuple[_Section, ...] = (
    (-2.26, 0.66, 0.34, 0.82, 0.58, 0.95),
    (-2.10, 0.84, 0.24, 0.88, 0.72, 1.06),
    (-1.62, 0.90, 0.20, 0.92, 0.74, 1.09),
    (-0.88, 0.90, 0.20, 0.94, 0.60, 1.38),
    (-0.40, 0.90, 0.20, 0.94, 0.60, 1.44),
    (0.25, 0.90, 0.20, 0.93, 0.61, 1.42),
    (1.08, 0.90, 0.20, 0.90, 0.74, 1.01),
    (1.90, 0.87, 0.20, 0.78, 0.66, 0.87),
    (2.18, 0.74, 0.26, 0.62, 0.52, 0.72),
    (2.27, 0.56, 0.34, 0.54, 0.44, 0.60),
)
_HATCHBACK: tuple[_Section, ...] = (
    (-2.02, 0.68, 0.34, 0.86, 0.60, 0.98),
    (-1.92, 0.82, 0.26, 0.92, 0.64, 1.10),
    (-1.42, 0.88, 0.20, 0.96, 0.60, 1.42),
    (-0.90, 0.88, 0.20, 0.96, 0.60, 1.48),
    (-0.25, 0.88, 0.20, 0.95, 0.61, 1.49),
    (0.25, 0.88, 0.20, 0.94, 0.61, 1.45),
    (1.05, 0.88, 0.20, 0.92, 0.72, 1.03),
    (1.68, 0.86, 0.20, 0.80, 0.66, 0.90),
    (1.94, 0.74, 0.26, 0.64, 0.54, 0.74),
    (2.02, 0.56, 0.34, 0.54, 0.44, 0.60),
)
_ESTATE: tuple[_Section, ...] = (
    (-2.30, 0.68, 0.34, 0.86, 0.60, 0.98),
    (-2.18, 0.84, 0.24, 0.92, 0.64, 1.12),
    (-1.80, 0.90, 0.20, 0.94, 0.60, 1.42),
    (-1.20, 0.90, 0.20, 0.94, 0.62, 1.48),
    (-0.40, 0.90, 0.20, 0.94, 0.62, 1.49),
    (0.25, 0.90, 0.20, 0.93, 0.62, 1.45),
    (1.08, 0.90, 0.20, 0.90, 0.74, 1.01),
    (1.90, 0.87, 0.20, 0.78, 0.66, 0.87),
    (2.20, 0.74, 0.26, 0.62, 0.52, 0.72),
    (2.30, 0.56, 0.34, 0.54, 0.44, 0.60),
)
_SUV: tuple[_Section, ...] = (
    (-2.24, 0.72, 0.42, 0.98, 0.62, 1.10),
    (-2.14, 0.86, 0.32, 1.04, 0.66, 1.24),
    (-1.78, 0.92, 0.26, 1.06, 0.62, 1.60),
    (-1.20, 0.92, 0.26, 1.06, 0.63, 1.67),
    (-0.40, 0.92, 0.26, 1.05, 0.64, 1.68),
    (0.20, 0.92, 0.26, 1.04, 0.64, 1.63),
    (0.98, 0.92, 0.26, 1.02, 0.76, 1.14),
    (1.84, 0.88, 0.26, 0.94, 0.68, 1.03),
    (2.14, 0.76, 0.32, 0.76, 0.56, 0.88),
    (2.24, 0.58, 0.42, 0.66, 0.46, 0.72),
)
_VAN: tuple[_Section, ...] = (
    (-2.45, 0.86, 0.40, 1.10, 0.76, 1.84),
    (-2.38, 0.94, 0.28, 1.12, 0.82, 1.92),
    (-1.40, 0.96, 0.24, 1.12, 0.82, 1.96),
    (0.20, 0.96, 0.24, 1.12, 0.80, 1.96),
    (0.95, 0.96, 0.24, 1.10, 0.76, 1.84),
    (1.80, 0.95, 0.24, 1.04, 0.78, 1.18),
    (2.22, 0.88, 0.26, 0.88, 0.66, 1.00),
    (2.42, 0.74, 0.34, 0.72, 0.54, 0.80),
    (2.48, 0.58, 0.40, 0.62, 0.46, 0.66),
)
_PICKUP: tuple[_Section, ...] = (
    (-2.62, 0.84, 0.50, 0.98, 0.76, 1.04),
    (-2.56, 0.92, 0.36, 1.04, 0.84, 1.08),
    (-1.00, 0.92, 0.28, 1.06, 0.84, 1.10),
    (-0.86, 0.92, 0.28, 1.08, 0.66, 1.70),
    (-0.30, 0.92, 0.28, 1.08, 0.66, 1.78),
    (0.40, 0.92, 0.28, 1.06, 0.66, 1.74),
    (1.18, 0.92, 0.28, 1.04, 0.76, 1.18),
    (2.20, 0.90, 0.28, 0.96, 0.70, 1.06),
    (2.54, 0.78, 0.34, 0.78, 0.58, 0.90),
    (2.62, 0.60, 0.42, 0.66, 0.48, 0.74),
)

_WHEEL_RADIUS_M = 0.32
_WHEEL_WIDTH_M = 0.22

_SECTIONS = {
    "saloon": _SALOON,
    "hatchback": _HATCHBACK,
    "estate": _ESTATE,
    "suv": _SUV,
    "van": _VAN,
    "pickup": _PICKUP,
}

VEHICLES: tuple[str, ...] = tuple(_SECTIONS)
"""Names of the vehicles that ``vehicle_mesh`` can make."""


def vehicle_mesh(kind: str) -> Mesh:
    """Triangle mesh of a generic vehicle in the object frame.

    Parameters
    ----------
    kind : one of ``VEHICLES``.

    Returns
    -------
    Mesh
        Metres; z up, front at +x, base centre at the origin. Body and wheels are closed shells.

    Raises
    ------
    ValueError
        If there is no vehicle of that name.
    """
    if kind not in _SECTIONS:
        raise ValueError(f"no vehicle named {kind!r}; there are {', '.join(VEHICLES)}")
    rings: list[F64] = []
    for x, belt_y, sill_z, belt_z, top_y, top_z in _SECTIONS[kind]:
        half = [(0.92 * belt_y, sill_z), (belt_y, 0.5 * (sill_z + belt_z)), (belt_y, belt_z)]
        half.append((top_y, top_z - 0.03 * min(1.0, top_y)))
        left = [(x, y, z) for y, z in half]
        rings.append(np.array([*left, (x, 0.0, top_z), *((x, -y, z) for y, z in reversed(half))]))
    corners = np.concatenate(rings)
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, 0.0]
    length, belt_y = high[0] - low[0], high[1]
    wheels = [
        placed(_wheel(), (x, y + _WHEEL_WIDTH_M / 2, 0.0))
        for x in (-0.29 * length, 0.29 * length)
        for y in (-belt_y + 0.03, belt_y - 0.25)
    ]
    return merged([lofted([ring - middle for ring in rings]), *wheels])


def _wheel() -> Mesh:
    """Closed 12-sided wheel that stands on one of its sides."""
    angle = (np.arange(12) + 0.5) * (2 * np.pi / 12)
    rim = _WHEEL_RADIUS_M / np.cos(np.pi / 12) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return extruded(rim + [0.0, _WHEEL_RADIUS_M], _WHEEL_WIDTH_M)
