"""Artificial scenes of the recognition benchmark: instances among decoys and clutter, and files.

Of the eight instances of a scene three stand free, two in a row with a decoy (a tenth of their
width and no gap between them), one was seen from one side only, one half under a canopy, one is
cut off by the border.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from recognition_objects import Sought
from recognition_sampling import Ground, Thing, View, points_of

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply
from spinpipe.schemas.arrays import F64
from spinpipe.stages.geometry.frames import yaw_matrix
from spinpipe.stages.geometry.shapes import Mesh, box, cylinder, ellipsoid, placed

Disc = tuple[float, float, float]
"""x, y, radius, metres."""

FREE = 3
SINGLE_DECOYS = 9
FILLED = 0.35
"""Share of the ground that the discs around all things cover."""
TILT_DEG = 2.0


@dataclass(frozen=True)
class Condition:
    """How a scene is sampled: lengths as shares of the object."""

    name: str
    spacings_across: float
    """Points across the narrow extent."""
    noise: float
    """Standard deviation as a share of the geometric mean of the three extents."""
    view: View


CONDITIONS = (
    Condition("base", 20, 0.01, "all"),
    Condition("sparse", 10, 0.0, "all"),
    Condition("noisy", 20, 0.06, "all"),
    Condition("drone", 20, 0.01, "above"),
    Condition("drone fine", 40, 0.03, "above"),
    Condition("skin", 20, 0.01, "skin"),
)


@dataclass(frozen=True)
class Scene:
    """What was written, and what stands where in scene coordinates."""

    cloud: Path
    model: Path
    truth: Path
    things: list[Thing]
    points: int


@dataclass
class _Site:
    """Ground that fills up."""

    rng: np.random.Generator
    half_m: float
    taken: list[tuple[float, float, float]] = field(
        default_factory=list[tuple[float, float, float]]
    )

    def place(self, radius_m: float) -> tuple[float, float]:
        reach = self.half_m - radius_m
        x, y = 0.0, 0.0
        for _ in range(5000):
            x, y = self.rng.uniform(-reach, reach, 2).tolist()
            if all(math.hypot(x - u, y - v) > radius_m + r for u, v, r in self.taken):
                break
        self.taken.append((x, y, radius_m))  # a scene without room is crowded: no error
        return x, y


def make_scene(sought: Sought, condition: Condition, seed: int, folder: Path) -> Scene:
    """Make a scene and write scene.ply, model.ply and truth.csv; equal seeds give equal scenes."""
    name = f"{sought.name}/{condition.name}"
    rng = np.random.default_rng([seed, *name.encode()])
    mesh = sought.mesh()
    size = np.ptp(mesh.vertices, axis=0)
    narrow, mean = float(min(size[:2])), float(np.cbrt(size.prod()))
    radius = float(np.hypot(*size[:2])) / 2
    # discs of about 12 groups as wide as the object, and the decoys
    decoys = [(n, make()) for n, make in sought.decoys]
    reach = [float(np.hypot(*np.ptp(m.vertices, axis=0)[:2])) / 2 for _, m in decoys]
    area = math.pi * (10 * radius**2 + (2.5 * radius) ** 2 + SINGLE_DECOYS * np.mean(reach) ** 2)
    half = math.sqrt(area / FILLED) / 2
    site = _Site(rng, half)
    uneven = Ground(0.04 * float(size[2]) * int(rng.integers(2)), 12 * radius)
    things = _instances(sought.name, mesh, decoys, site)
    for k in range(SINGLE_DECOYS):
        decoy, shape = decoys[k % len(decoys)]
        things.append(_stand(decoy, "decoy", shape, site, reach[k % len(decoys)]))
    things += _clutter(site, size, radius)
    things = [t.on(uneven) for t in things]
    xyz = points_of(things, uneven, half, narrow / condition.spacings_across, condition.view, rng)
    xyz += condition.noise * mean * rng.standard_normal(xyz.shape)
    tilt = _tilt(rng) if not uneven.amplitude_m else np.eye(3)
    folder.mkdir(parents=True, exist_ok=True)
    scene, model, truth = (folder / f for f in ("scene.ply", "model.ply", "truth.csv"))
    write_ply(scene, cloud_rows(xyz @ tilt.T))
    write_ply(model, cloud_rows(mesh.vertices), mesh.faces.astype(np.int32))
    things = [t.turned(tilt) for t in things]
    write_atomically(truth, partial(_write_truth, things=things))
    return Scene(scene, model, truth, things, len(xyz))


def _tilt(rng: np.random.Generator) -> F64:
    """Rotation by ``TILT_DEG`` about a random horizontal axis."""
    azimuth, angle = rng.uniform(0, 360), math.radians(TILT_DEG)
    turn = yaw_matrix(float(azimuth))[:3, :3]
    cos, sin = math.cos(angle), math.sin(angle)
    return turn @ np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]) @ turn.T


def _write_truth(path: Path, things: list[Thing]) -> None:
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["model", "x", "y", "z", "heading_deg"])
        for thing in things:
            if thing.sought:
                table.writerow([thing.name, *thing.position, thing.heading_deg])


def _stand(name: str, kind: str, mesh: Mesh, site: _Site, radius: float) -> Thing:
    x, y = site.place(radius)
    return Thing(name, kind, mesh, (x, y, 0.0), float(site.rng.uniform(0, 360)))


def _instances(name: str, mesh: Mesh, decoys: list[tuple[str, Mesh]], site: _Site) -> list[Thing]:
    size = np.ptp(mesh.vertices, axis=0)
    radius, narrow = float(np.hypot(*size[:2])) / 2, float(min(size[:2]))
    # a row along the narrow extent: decoy, instance, instance
    x, y = site.place(2.5 * radius)
    heading = float(site.rng.uniform(0, 360))
    across = heading + (90 if size[1] <= size[0] else 0)
    step = np.array([math.cos(math.radians(across)), math.sin(math.radians(across))])
    beside, shape = decoys[int(site.rng.integers(len(decoys)))]
    depth = np.ptp(shape.vertices, axis=0)[int(size[1] <= size[0])]
    gaps = ((beside, "decoy", shape, -(narrow + depth) / 2), (name, "row", mesh, 0.0))
    row = [*gaps, (name, "row", mesh, 1.1 * narrow)]
    things = [
        Thing(n, kind, m, (*(np.array([x, y]) + d * step).tolist(), 0.0), heading)
        for n, kind, m, d in row
    ]
    things += [_stand(name, "free", mesh, site, radius) for _ in range(FREE)]
    one_sided = _stand(name, "one-sided", mesh, site, radius)
    away = site.rng.uniform(0, 2 * math.pi)
    unseen = (math.cos(away), math.sin(away))
    things.append(Thing(name, "one-sided", mesh, one_sided.position, one_sided.heading_deg, unseen))
    sheltered = _stand(name, "canopy", mesh, site, 1.4 * radius)
    angle = site.rng.uniform(0, 2 * math.pi)
    roof_at = (
        sheltered.position[0] + radius * math.cos(angle),
        sheltered.position[1] + radius * math.sin(angle),
        1.4 * float(size[2]),
    )
    roof = box(2 * radius, 2.4 * radius, 0.05 * float(size[2]))
    things += [sheltered, Thing("canopy", "clutter", roof, roof_at, math.degrees(angle))]
    # a fifth to a third of it beyond the border
    edge = (site.half_m - 0.25 * narrow, float(site.rng.uniform(-0.7, 0.7)) * site.half_m)
    site.taken.append((*edge, radius))
    things.append(Thing(name, "border", mesh, (*edge, 0.0), float(site.rng.uniform(0, 360))))
    return things


def _clutter(site: _Site, size: F64, radius: float) -> list[Thing]:
    """Two walls, three poles and four bushes, as large as such things are beside the object."""
    rng, height = site.rng, float(size[2])
    things: list[Thing] = []
    for _ in range(2):
        length = float(rng.uniform(2, 4)) * radius
        wall = box(length, 0.2 * radius, float(rng.uniform(0.8, 2)) * height)
        things.append(_stand("wall", "clutter", wall, site, 0.4 * length))
    for _ in range(3):
        pole = cylinder(0.07 * radius, float(rng.uniform(1.5, 3)) * height, 8)
        things.append(_stand("pole", "clutter", pole, site, 0.2 * radius))
    for _ in range(4):
        x, y, z = (rng.uniform(0.4, 1.0, 3) * [radius, radius, 0.6 * height]).tolist()
        bush = placed(ellipsoid((x, y, z)), (0, 0, -0.2 * z))
        thing = _stand("bush", "clutter", bush, site, max(x, y))
        things.append(thing.rough(0.06 * radius))
    return things
