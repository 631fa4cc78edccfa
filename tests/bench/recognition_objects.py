"""Objects of the recognition benchmark that are no cars, and what each is easily taken for.

Every mesh is in frame ``object``: metres, z up, the middle of the base at the origin, front at +x.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from spinpipe.stages.geometry.shapes import Mesh, box, cylinder, extruded, lofted, merged, placed
from spinpipe.stages.ingest.vehicles import vehicle_mesh

ROUND = 0
"""Order of symmetry of what looks the same from everywhere."""


@dataclass(frozen=True)
class Sought:
    """An object to look for.

    Attributes
    ----------
    mesh : made anew by each call.
    symmetry : how many headings look alike; ``ROUND``: all.
    decoys : what stands beside it; each differs by a quarter in an extent, or in its form.
    """

    name: str
    mesh: Callable[[], Mesh]
    symmetry: int
    decoys: Sequence[tuple[str, Callable[[], Mesh]]]


def _at(mesh: Mesh, x: float, y: float, z: float, heading_deg: float = 0.0) -> Mesh:
    return placed(mesh, (x, y, z), heading_deg)


def _centred(*parts: Mesh) -> Mesh:
    whole = merged(parts)
    low, high = whole.vertices.min(axis=0), whole.vertices.max(axis=0)
    return Mesh(whole.vertices - [*((low + high) / 2)[:2], low[2]], whole.faces)


def _legs(length: float, width: float, height: float, thick: float) -> list[Mesh]:
    return [
        _at(box(thick, thick, height), sx * (length - thick) / 2, sy * (width - thick) / 2, 0)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]


def table(length: float, width: float, height: float, thick: float = 0.06) -> Mesh:
    """Top on four legs."""
    top = _at(box(length, width, 0.04), 0, 0, height - 0.04)
    return _centred(top, *_legs(length, width, height - 0.04, thick))


def chair(seat_z: float = 0.43, size: float = 0.46, back_z: float = 0.92) -> Mesh:
    """Seat, four legs and a back at the rear."""
    seat = _at(box(size, size, 0.04), 0, 0, seat_z)
    back = _at(box(0.04, size, back_z - seat_z), -(size - 0.04) / 2, 0, seat_z)
    return _centred(seat, back, *_legs(size, size, seat_z, 0.04))


def armchair() -> Mesh:
    """Wider than the chair, on a solid base."""
    arms = [_at(box(0.7, 0.12, 0.6), 0, side * 0.3, 0) for side in (-1, 1)]
    return _centred(box(0.7, 0.7, 0.4), _at(box(0.15, 0.7, 0.85), -0.27, 0, 0), *arms)


def desk() -> Mesh:
    """Table top on drawers at one end and a panel at the other, closed at the far side."""
    top = _at(box(1.6, 0.8, 0.04), 0, 0, 0.7)
    drawers = _at(box(0.42, 0.7, 0.7), 0.55, 0, 0)
    panel, front = _at(box(0.04, 0.7, 0.7), -0.76, 0, 0), _at(box(1.5, 0.03, 0.45), 0, 0.33, 0.25)
    return _centred(top, drawers, panel, front)


def barrel(radius: float = 0.29, height: float = 0.88) -> Mesh:
    """Oil barrel with two hoops."""
    hoops = [_at(cylinder(1.04 * radius, 0.04, 24), 0, 0, k * height / 3 - 0.02) for k in (1, 2)]
    return _centred(cylinder(radius, height, 24), *hoops)


def lathe() -> Mesh:
    """Bed on two pedestals, headstock, carriage and tailstock, motor at the back."""
    pedestals = [_at(box(0.5, 0.5, 0.6), x, 0, 0) for x in (-0.65, 0.65)]
    bed, head = _at(box(1.9, 0.45, 0.2), 0, 0, 0.6), _at(box(0.5, 0.5, 0.45), -0.68, 0, 0.8)
    tail, carriage = _at(box(0.22, 0.25, 0.28), 0.75, 0, 0.8), _at(box(0.3, 0.55, 0.14), 0, 0, 0.8)
    motor = _at(box(0.35, 0.25, 0.4), -0.65, 0.37, 0.15)
    return _centred(*pedestals, bed, head, tail, carriage, motor)


def milling_machine() -> Mesh:
    """Base, column, table and head."""
    base, column = box(0.9, 0.6, 0.5), _at(box(0.4, 0.4, 1.6), -0.25, 0, 0)
    bench, head = _at(box(0.3, 1.2, 0.15), 0.2, 0, 0.85), _at(box(0.7, 0.3, 0.35), 0.1, 0, 1.4)
    return _centred(base, column, bench, head)


def compressor() -> Mesh:
    """Lying tank on feet with motor and pump on it and a handle at the rear."""
    ring = [(0.22 * math.cos(a), 0.22 * math.sin(a)) for a in np.arange(16) * math.pi / 8]
    tank = _at(extruded(ring, 1.2), 0, 0, 0.37, 90)
    motor, pump = _at(box(0.35, 0.3, 0.3), 0.3, 0, 0.57), _at(cylinder(0.13, 0.35), -0.15, 0, 0.56)
    feet = [_at(box(0.1, 0.3, 0.25), x, 0, 0) for x in (-0.45, 0.45)]
    struts = [_at(box(0.25, 0.03, 0.03), -0.68, y, 0.6) for y in (-0.2, 0.2)]
    return _centred(tank, motor, pump, *feet, *struts, _at(box(0.04, 0.45, 0.04), -0.8, 0, 0.6))


def bench(length: float = 1.8, back: bool = True) -> Mesh:
    """Park bench: its back is at -x, its length along y."""
    seat = _at(box(0.4, length, 0.05), 0, 0, 0.42)
    ends = [_at(box(0.4, 0.08, 0.42), 0, y, 0) for y in (-0.4 * length, 0.4 * length)]
    rest = [_at(box(0.05, length, 0.42), -0.22, 0, 0.45)] if back else []
    return _centred(seat, *ends, *rest)


def wheelie_bin() -> Mesh:
    """Upright at the back, slanted in front, with lid, handle and wheels."""
    sections = [
        np.array([(rear, -y, z), (front, -y, z), (front, y, z), (rear, y, z)])
        for rear, front, y, z in ((-0.3, 0.15, 0.22, 0.06), (-0.34, 0.32, 0.29, 0.95))
    ]
    lid = extruded([(-0.36, 0.95), (0.36, 0.95), (0.36, 0.98), (-0.3, 1.07)], 0.6)
    ring = [(0.1 * math.cos(a), 0.1 + 0.1 * math.sin(a)) for a in np.arange(12) * math.pi / 6]
    wheels = [_at(extruded(ring, 0.05), -0.32, y, 0) for y in (-0.24, 0.24)]
    return _centred(lofted(sections), lid, *wheels, _at(box(0.05, 0.5, 0.05), -0.4, 0, 0.95))


def cone(height: float = 0.75) -> Mesh:
    """Traffic cone on its square foot."""
    foot = box(0.4, 0.4, 0.04)
    return _centred(foot, _at(cylinder(0.15, height - 0.04, 16, 0.03), 0, 0, 0.04))


def forklift() -> Mesh:
    """Body, counterweight, cabin roof on posts, mast and forks in front."""
    body, weight = _at(box(1.5, 1.1, 0.7), 0, 0, 0.2), _at(box(0.5, 1.1, 0.9), -0.7, 0, 0.25)
    posts = [_at(box(0.07, 0.07, 1.2), x, y, 0.9) for x in (-0.45, 0.6) for y in (-0.45, 0.45)]
    roof, mast = _at(box(1.15, 1.0, 0.06), 0.07, 0, 2.05), _at(box(0.15, 0.8, 2.0), 0.85, 0, 0.1)
    forks = [_at(box(1.0, 0.12, 0.05), 1.4, y, 0.06) for y in (-0.25, 0.25)]
    wheels = [_at(box(0.5, 0.2, 0.45), x, y, 0) for x in (-0.55, 0.5) for y in (-0.46, 0.46)]
    return _centred(body, weight, *posts, roof, mast, *forks, *wheels)


def vehicle(shape: str, scale: float = 1.0) -> Mesh:
    """One of the vehicles that ship."""
    vertices, faces = vehicle_mesh(shape)
    return _centred(Mesh(scale * vertices, faces))


SOUGHT: tuple[Sought, ...] = (
    Sought("chair", chair, 1, (
        ("stool", lambda: table(0.46, 0.46, 0.47, 0.04)),
        ("armchair", armchair),
        ("box", lambda: box(0.46, 0.46, 0.65)),
        ("drum", lambda: cylinder(0.23, 0.9)),
        ("side table", lambda: table(0.6, 0.6, 0.7)),
    )),
    Sought("table", lambda: table(1.4, 0.8, 0.74), 2, (
        ("coffee table", lambda: table(1.4, 0.8, 0.45)),
        ("long table", lambda: table(1.8, 0.9, 0.74)),
        ("square table", lambda: table(0.8, 0.8, 0.74)),
        ("box", lambda: box(1.4, 0.8, 0.95)),
        ("bench", bench),
    )),
    Sought("desk", desk, 1, (
        ("short table", lambda: table(1.2, 0.8, 0.74)),
        ("high table", lambda: table(1.6, 0.8, 0.95)),
        ("box", lambda: box(1.2, 0.6, 0.7)),
        ("lathe", lathe),
    )),
    Sought("cabinet", lambda: box(0.9, 0.45, 1.2), 2, (
        ("wide cabinet", lambda: box(1.2, 0.45, 1.2)),
        ("low cabinet", lambda: box(0.9, 0.45, 0.85)),
        ("narrow cabinet", lambda: box(0.6, 0.45, 1.2)),
        ("deep cabinet", lambda: box(0.9, 0.65, 1.2)),
        ("chair", chair),
    )),
    Sought("barrel", barrel, ROUND, (
        ("wide barrel", lambda: barrel(0.3625)),
        ("high barrel", lambda: barrel(0.29, 1.15)),
        ("box", lambda: box(0.58, 0.58, 0.88)),
        ("bin", wheelie_bin),
        ("thin barrel", lambda: barrel(0.21)),
    )),
    Sought("lathe", lathe, 1, (
        ("box", lambda: box(1.9, 0.6, 0.9)),
        ("milling machine", milling_machine),
        ("desk", desk),
        ("cabinet", lambda: box(0.9, 0.45, 1.2)),
    )),
    Sought("compressor", compressor, 1, (
        ("box", lambda: box(1.2, 0.45, 0.7)),
        ("lying barrel", lambda: _centred(placed(box(1.2, 0.5, 0.5), (0, 0, 0)))),
        ("barrel", barrel),
        ("bench", bench),
    )),
    Sought("bench", bench, 1, (
        ("seat", lambda: bench(back=False)),
        ("short bench", lambda: bench(1.3)),
        ("box", lambda: box(0.5, 1.8, 0.6)),
        ("table", lambda: table(0.7, 1.8, 0.74)),
    )),
    Sought("bin", wheelie_bin, 1, (
        ("box", lambda: box(0.72, 0.58, 0.8)),
        ("wide box", lambda: box(0.9, 0.58, 1.07)),
        ("barrel", barrel),
        ("cabinet", lambda: box(0.9, 0.45, 1.2)),
    )),
    Sought("cone", cone, ROUND, (
        ("bollard", lambda: cylinder(0.1, 0.9)),
        ("low cone", lambda: cone(0.5)),
        ("box", lambda: box(0.3, 0.3, 0.7)),
        ("barrel", barrel),
    )),
    Sought("forklift", forklift, 1, (
        ("box", lambda: box(2.4, 1.1, 1.5)),
        ("saloon", lambda: vehicle("saloon")),
        ("milling machine", milling_machine),
        ("crate stack", lambda: _centred(box(1.2, 1.0, 2.0), _at(box(1.2, 1.0, 1.0), 1.2, 0, 0))),
    )),
    Sought("saloon", lambda: vehicle("saloon"), 1, (
        ("van", lambda: vehicle("van")),
        ("pickup", lambda: vehicle("pickup")),
        ("small saloon", lambda: vehicle("saloon", 0.8)),
        ("box", lambda: box(4.2, 1.8, 1.2)),
    )),
)  # fmt: skip
