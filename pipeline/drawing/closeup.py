"""What is around each candidate: its points explained or not, its model's surface seen or not.

Shown, never used to decide: the classes are those of the evidence (``stages/verify``) in the plain
form that a picture needs. A point is *explained* within the model's gate of its surface, *ground*
below where anything could be told from it, *unexplained* elsewhere in the model's box. A piece of
surface is *seen* where a point lies within the gate, *contradicted* where the scene shows something
below it and nothing at or above it, *not observed* elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from scipy.spatial import KDTree

from spinpipe.schemas import CLOUD, CLUSTERS, HITS, MODELS, SAMPLING, SPIN_IMAGES, TILES, UPRIGHT
from spinpipe.schemas.arrays import F32, F64, U8
from spinpipe.schemas.records import Detection, Hits, ObjectModel, Sampling, SpinImage, Vector
from spinpipe.schemas.topics import Topic
from spinpipe.stages.geometry.frames import to_world
from spinpipe.stages.geometry.shapes import sample_surface
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.scan.image import SpinGrid, spin_image

T = TypeVar("T")

GROUND, EXPLAINED, UNEXPLAINED, AROUND = range(4)
WHAT = ("ground", "explained", "unexplained", "around")
SEEN, CONTRADICTED, NOT_OBSERVED = range(3)
SIGHT = ("seen", "contradicted", "not observed")

SURFACE_POINTS = 700
TREE_POINTS = 8000
"""Of a mesh: closer together than the points of a cloud of a small object."""
MARGIN = 0.45
"""What is shown beside the object, as a share of its longer side."""
AT_ONCE = 400
"""Candidates whose points are held together."""
LOW_SHARE = 0.07
"""What is lower than this share of the height may be ground, as for the evidence."""


class Reader(Protocol):
    """Gives all messages of a topic of the run."""

    def __call__(self, topic: Topic[T], /) -> Sequence[T]:
        """Messages in the order in which they were written."""
        ...


@dataclass(frozen=True, eq=False)
class Closeup:
    """Surroundings of one candidate.

    Coordinates are in its own frame: metres, z up, middle of the object's base at the origin, +x
    where it is headed; nothing is stretched.
    """

    detection: Detection
    xyz: F32
    """(N, 3) points of the cloud."""
    rgb: U8
    """(N, 3)."""
    what: U8
    """(N,) place in ``WHAT``."""
    surface: F32
    """(M, 3) points of the fitted model's surface."""
    sight: U8
    """(M,) place in ``SIGHT``."""
    spin: F32
    """(rows, columns) counts around the best hit of the candidate; (0, 0) without one."""


@dataclass(frozen=True)
class _Look:
    """One model as it is compared with points."""

    seen: F64
    """(M, 3) surface that the sensor could see, object frame."""
    tree: KDTree
    """All of its surface."""
    narrow_m: float
    stretch: float


def closeups(read: Reader, detections: Sequence[Detection], most_points: int) -> Iterator[Closeup]:
    """Cut out and classify what is around each detection, in their order.

    Parameters
    ----------
    read : reader of a complete run.
    detections : to look at.
    most_points : of the cloud kept for each; classes are found before thinning.
    """
    if not detections:
        return
    looks = {model.name: _look(model) for model in read(MODELS)}
    spins = {image.model: image for image in read(SPIN_IMAGES) if image.role == "model"}
    hits = {group.model: group for group in read(HITS)}
    places = {cluster.id: cluster.position for cluster in read(CLUSTERS)}
    sampling = read(SAMPLING)[0]
    cloud = WorldCloud.of(read(CLOUD), read(TILES)[0], read(UPRIGHT)[0])
    for start in range(0, len(detections), AT_ONCE):
        block = detections[start : start + AT_ONCE]
        reach = [_reach(d, spins.get(d.model)) for d in block]
        for d, (xyz, rgb) in zip(block, _cut(cloud, block, reach), strict=True):
            spin = _own_spin(xyz, places.get(d.cluster), spins.get(d.model), hits.get(d.model))
            yield _closeup(d, xyz, rgb, spin, looks[d.model], sampling, most_points)


def gate_m(narrow_m: float, stretch: float, sampling: Sampling) -> float:
    """How far a point may lie from a model's surface and be explained by it, metres.

    As ``stages/verify`` has it: noise, spacing and unknown shape in quadrature.
    """
    shape = stretch * narrow_m
    return float(np.sqrt((3 * sampling.noise_m) ** 2 + sampling.spacing_m**2 + shape**2))


def _look(model: ObjectModel) -> _Look:
    seen = np.asarray(model.points if len(model.points) else model.vertices, np.float64)
    every = seen
    if len(model.faces):  # points may lie on what the sensor saw little of, too
        rng = np.random.default_rng(0)
        every, _ = sample_surface(model.vertices, model.faces, TREE_POINTS, rng)
    return _Look(seen, KDTree(every), float(model.size.min()) / 2, model.stretch)


def _reach(d: Detection, spin: SpinImage | None) -> float:
    """Half side of the square that is cut out, metres."""
    length, width = max(d.size_m[:2]), min(d.size_m[:2])
    own = 0.5 * float(np.hypot(length, width)) + MARGIN * length
    return max(own, 1.5 * spin.radius_m if spin else 0.0)


def _cut(
    cloud: WorldCloud, detections: Sequence[Detection], reach: Sequence[float]
) -> list[tuple[F32, U8]]:
    """World points and colours in a square around each; every tile is read once."""
    places = np.array([d.position_world for d in detections])
    half = np.array(reach)
    found: list[list[tuple[F32, U8]]] = [[] for _ in detections]
    for number in range(len(cloud)):
        near = np.flatnonzero(
            np.all(places[:, :2] + half[:, None] >= cloud.low[number, :2], axis=1)
            & np.all(places[:, :2] - half[:, None] <= cloud.high[number, :2], axis=1)
        )
        if not len(near):
            continue
        tile = cloud.tiles[number]
        xyz = to_world(cloud.upright, tile.xyz)
        order = np.argsort(xyz[:, 0], kind="stable")
        x = xyz[order, 0]
        for i in near:
            first, last = np.searchsorted(x, [places[i, 0] - half[i], places[i, 0] + half[i]])
            rows = order[first:last]
            rows = rows[abs(xyz[rows, 1] - places[i, 1]) <= half[i]]
            found[i].append((xyz[rows], tile.rgb[rows]))
    empty = (np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))
    return [
        (np.concatenate([p for p, _ in [*f, empty]]), np.concatenate([c for _, c in [*f, empty]]))
        for f in found
    ]


def _closeup(
    d: Detection,
    world: F32,
    rgb: U8,
    spin: F32,
    look: _Look,
    sampling: Sampling,
    most_points: int,
) -> Closeup:
    size = np.asarray(d.size_m, np.float64)
    angle = np.radians(d.heading_deg)
    cos, sin = np.cos(angle), np.sin(angle)
    xyz = world.astype(np.float64) - d.position_world
    xyz = xyz @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]])
    stretch = np.linalg.norm(d.T_world_object[:3, :3], axis=0)
    gate = gate_m(look.narrow_m, look.stretch, sampling)
    high = 1.5 * size[2] + 0.5
    kept = (xyz[:, 2] > -0.5 * size[2]) & (xyz[:, 2] < high)
    kept &= np.all(abs(xyz[:, :2]) < size[:2] / 2 + MARGIN * size[:2].max(), axis=1)
    xyz, rgb = xyz[kept], rgb[kept]
    what = _classify(xyz, look, stretch, size, gate, sampling)
    step = max(1, len(look.seen) // SURFACE_POINTS)
    surface = look.seen[::step] * stretch
    sight = _see(surface, xyz, gate, sampling)
    shown = np.arange(min(most_points, len(xyz))) * len(xyz) // max(min(most_points, len(xyz)), 1)
    return Closeup(
        d, xyz[shown].astype(np.float32), rgb[shown], what[shown], surface.astype(np.float32),
        sight, spin,
    )  # fmt: skip


def _classify(
    xyz: F64, look: _Look, stretch: F64, size: F64, gate: float, sampling: Sampling
) -> U8:
    what = np.full(len(xyz), AROUND, np.uint8)
    if not len(xyz):
        return what
    low = max(3 * sampling.noise_m, LOW_SHARE * size[2])
    inside = np.all(abs(xyz[:, :2]) <= size[:2] / 2 + gate, axis=1) & (xyz[:, 2] < size[2] + gate)
    what[inside & (xyz[:, 2] > low)] = UNEXPLAINED
    distance, _ = look.tree.query(xyz / stretch, distance_upper_bound=gate / stretch.min())
    what[inside & (xyz[:, 2] > low) & np.isfinite(distance)] = EXPLAINED
    what[xyz[:, 2] <= low] = GROUND
    return what


def _see(surface: F64, xyz: F64, gate: float, sampling: Sampling) -> U8:
    sight = np.full(len(surface), NOT_OBSERVED, np.uint8)
    if not len(xyz):
        return sight
    distance, _ = KDTree(xyz).query(surface, distance_upper_bound=gate)
    seen = np.isfinite(distance)
    sight[seen] = SEEN
    unseen = np.flatnonzero(~seen)
    column = KDTree(xyz[:, :2])
    radius = max(sampling.spacing_m, 0.5 * gate)
    for i, rows in zip(unseen, column.query_ball_point(surface[unseen, :2], radius), strict=True):
        z = xyz[rows, 2]
        if len(z) and z.max() < surface[i, 2] - gate:
            sight[i] = CONTRADICTED
    return sight


def _own_spin(world: F32, place: Vector | None, model: SpinImage | None, hits: Hits | None) -> F32:
    """The spin image around the candidate's best hit, counted as the scan counts."""
    if place is None or model is None or hits is None:
        return np.empty((0, 0), np.float32)
    near = np.linalg.norm(hits.points - np.asarray(place, np.float32), axis=1) <= model.radius_m
    if not near.any():
        return np.empty((0, 0), np.float32)
    best = np.flatnonzero(near)[np.argmax(hits.correlation[near])]
    grid = SpinGrid.of(model.radius_m, model.height_m, model.bin_m)
    return spin_image(world, hits.points[best], grid).astype(np.float32)
