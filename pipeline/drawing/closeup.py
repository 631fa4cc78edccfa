"""What is around each candidate: its points explained or not, its model's surface seen or not.

Shown, never used to decide. The limits are those by which it was judged (``gate_m`` and ``sharp_m``
of a detection), and the classes follow the rules of the evidence (``stages/verify/evidence``), told
piece by piece instead of summed. A point is *explained* within the gate of the model's surface,
*ground* below where anything could be told from it, *unexplained* elsewhere in the model's box. A
piece of surface is *seen* where the points around it lie on it, *contradicted* where they lie
beside it or the scene shows something below it and nothing at or above it, else *not observed*.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from spinpipe.pipeline.drawing import palette
from spinpipe.schemas import CLOUD, CLUSTERS, HITS, MODELS, SAMPLING, SPIN_IMAGES, TILES, UPRIGHT
from spinpipe.schemas.arrays import F32, F64, U8
from spinpipe.schemas.records import Detection, Hits, ObjectModel, Sampling, SpinImage, Vector
from spinpipe.schemas.topics import Topic
from spinpipe.stages.geometry.frames import to_world
from spinpipe.stages.geometry.shapes import sample_surface
from spinpipe.stages.geometry.skin import shown
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
POINTS_AT_ONCE = 1_000_000
"""About so many points are held together, of candidates that lie near each other."""
LOW_SHARE = 0.07
"""What is lower than this share of the height may be ground, as for the evidence."""
COLUMN_SPACINGS = 2.0
"""Radius of the column around a piece of surface, in spacings of the points; likewise."""


class Reader(Protocol):
    """Gives all messages of a topic of the run."""

    def __call__(self, topic: Topic[T], /) -> Sequence[T]:
        """Messages in the order in which they were written."""
        ...


@dataclass(frozen=True, eq=False)
class Closeup:
    """Surroundings of one candidate.

    Coordinates are in its own frame, which leans with it: metres, z up, middle of the object's base
    at the origin, +x where it is headed; nothing is stretched.
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
    """(M, 3) some of the surface that the sensor could see, object frame."""
    normals: F64
    """(M, 3) outwards; z where the model has none."""
    tree: KDTree
    """All of its surface."""


def worth_a_look(detections: Sequence[Detection], most: int) -> list[Detection]:
    """Those that are looked at closely: the kept ones, then rejected ones and duplicates in turn.

    Each from the highest odds downwards. Duplicates alone, whose odds are high, would leave no room
    for those that somebody wants to know the reason of.
    """
    turn = Counter[str]()
    order: list[tuple[int, int, Detection]] = []
    for d in sorted(detections, key=lambda d: (-d.log_odds, -d.score, d.id)):
        rank = palette.rank(d.fate)
        kept = d.fate in palette.KEPT
        order.append((0, rank, d) if kept else (1 + turn[d.fate], -rank, d))
        turn[d.fate] += 1
    return [d for *_, d in sorted(order, key=lambda o: o[:2])[:most]]


def closeups(read: Reader, detections: Sequence[Detection], most_points: int) -> Iterator[Closeup]:
    """Cut out and classify what is around each detection, in their order.

    Parameters
    ----------
    read : reader of a complete run.
    detections : to look at.
    most_points : of the cloud kept for each; the surface is compared with all of them.
    """
    if not detections:
        return
    spins = {image.model: image for image in read(SPIN_IMAGES) if image.role == "model"}
    hits = {group.model: _Hits(group) for group in read(HITS) if len(group.points)}
    places = {cluster.id: cluster.position for cluster in read(CLUSTERS)}
    sampling = read(SAMPLING)[0]
    looks = {m.name: _look(shown(m, sampling)) for m in read(MODELS)}
    cloud = WorldCloud.of(read(CLOUD), read(TILES)[0], read(UPRIGHT)[0])
    reach = np.array([_reach(d, spins.get(d.model)) for d in detections])
    found: dict[int, Closeup] = {}
    for rows in _blocks(cloud, detections, sampling.density * (2 * reach) ** 2):
        block = [detections[row] for row in rows]
        for row, d, (xyz, rgb) in zip(rows, block, _cut(cloud, block, reach[rows]), strict=True):
            spin = _own_spin(xyz, places.get(d.id), spins.get(d.model), hits.get(d.model))
            found[row] = _closeup(d, xyz, rgb, spin, looks[d.model], sampling, most_points)
    yield from (found[row] for row in range(len(detections)))


def _look(model: ObjectModel) -> _Look:
    every = np.asarray(model.points if len(model.points) else model.vertices, np.float64)
    step = max(1, len(every) // SURFACE_POINTS)
    seen, normals = every[::step], np.tile([0.0, 0.0, 1.0], (len(every[::step]), 1))
    if len(model.normals) == len(every) and model.normals.any():
        normals = np.asarray(model.normals[::step], np.float64)
    if len(model.faces):  # points may lie on what the sensor saw little of, too
        rng = np.random.default_rng(0)
        every, _ = sample_surface(model.vertices, model.faces, TREE_POINTS, rng)
    return _Look(seen, normals, KDTree(every))


def _reach(d: Detection, spin: SpinImage | None) -> float:
    """Half side of the square that is cut out, metres."""
    length, width = max(d.size_m[:2]), min(d.size_m[:2])
    own = 0.5 * float(np.hypot(length, width)) + MARGIN * length
    return max(own, 1.5 * spin.radius_m if spin else 0.0)


def _blocks(cloud: WorldCloud, detections: Sequence[Detection], points: F64) -> Iterator[list[int]]:
    """Rows of detections, tile by tile, that have about ``POINTS_AT_ONCE`` points together."""
    places = np.array([d.position_world for d in detections])[:, None, :2]
    inside = (places >= cloud.low[:, :2]) & (places <= cloud.high[:, :2])
    order = np.argsort(inside.all(axis=2).argmax(axis=1), kind="stable")
    block = np.cumsum(points[order]) // POINTS_AT_ONCE
    for number in np.unique(block):
        yield order[block == number].tolist()


def _cut(cloud: WorldCloud, detections: Sequence[Detection], half: F64) -> list[tuple[F32, U8]]:
    """World points and colours in a square around each; every tile is read once."""
    places = np.array([d.position_world for d in detections])
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
    stretch = np.linalg.norm(d.T_world_object[:3, :3], axis=0)
    xyz = (world - np.asarray(d.position_world)) @ (d.T_world_object[:3, :3] / stretch)
    beside = size[:2] / 2 + MARGIN * size[:2].max()
    kept = (xyz[:, 2] > -0.5 * size[2]) & (xyz[:, 2] < 1.5 * size[2] + 0.5)
    kept &= (abs(xyz[:, 0]) < beside[0]) & (abs(xyz[:, 1]) < beside[1])
    xyz, rgb = xyz[kept], rgb[kept]
    surface = look.seen * stretch
    sight = _see(surface, look.normals / stretch, xyz, d, sampling)
    count = min(most_points, len(xyz))
    some = np.arange(count) * len(xyz) // max(count, 1)
    xyz, rgb = xyz[some], rgb[some]
    what = _classify(xyz, look, stretch, d, sampling)
    near = np.asarray(xyz, np.float32)
    return Closeup(d, near, rgb, what, surface.astype(np.float32), sight, spin)


def _classify(xyz: F64, look: _Look, stretch: F64, d: Detection, sampling: Sampling) -> U8:
    what = np.full(len(xyz), AROUND, np.uint8)
    low_m = max(3 * sampling.noise_m, LOW_SHARE * d.size_m[2])
    reach = np.array([d.size_m[0] / 2, d.size_m[1] / 2, d.size_m[2]]) + d.gate_m
    rows = np.flatnonzero((abs(xyz) <= reach).all(axis=1) & (xyz[:, 2] > low_m))
    what[xyz[:, 2] <= low_m] = GROUND
    if len(rows):
        near = xyz[rows]
        least = float(stretch.min())
        away, nearest = look.tree.query(near / stretch, distance_upper_bound=d.gate_m / least)
        surface = look.tree.data[np.minimum(nearest, look.tree.n - 1)] * stretch
        explained = np.isfinite(away) & (((near - surface) ** 2).sum(axis=1) <= d.gate_m**2)
        within = (abs(near[:, :2]) <= np.array(d.size_m[:2]) / 2).all(axis=1)
        what[rows[explained]] = EXPLAINED
        what[rows[~explained & within & (near[:, 2] <= d.size_m[2])]] = UNEXPLAINED
    return what


def _see(surface: F64, normals: F64, xyz: F64, d: Detection, sampling: Sampling) -> U8:
    """``surface_evidence`` of ``stages/verify/evidence``, piece by piece of the surface."""
    sight = np.full(len(surface), NOT_OBSERVED, np.uint8)
    if not len(xyz):
        return sight
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    column_m = COLUMN_SPACINGS * sampling.spacing_m
    low, high = surface.min(axis=0) - column_m, surface.max(axis=0) + column_m
    xyz = xyz[((xyz[:, :2] >= low[:2]) & (xyz[:, :2] <= high[:2])).all(axis=1)]
    pairs = KDTree(xyz[:, :2]).sparse_distance_matrix(
        KDTree(surface[:, :2]), column_m, output_type="ndarray"
    )
    point, piece = pairs["i"], pairs["j"]
    away = xyz[point] - surface[piece]
    nz = np.maximum(normals[:, 2], 0.3)
    slope = np.sqrt(1 - np.minimum(nz, 1.0) ** 2) / nz
    band = (d.gate_m / nz + 0.5 * slope * column_m)[piece]
    at, above = abs(away[:, 2]) <= band, away[:, 2] > band
    inset = np.array(d.size_m[:2]) / 2 - 0.5 * d.sharp_m  # what lies beside is no sight through
    below = (away[:, 2] < -band) & (abs(xyz[point, :2]) < inset).all(axis=1)

    def count(which: NDArray[Any]) -> F64:
        return np.bincount(piece, which, len(surface)).astype(np.float64)

    n_at, n_below, n_above = count(at), count(below), count(above)
    enough = max(0.25 * sampling.density * np.pi * column_m**2, 1.0)
    some = np.maximum(n_at, 1.0)
    offset = count(at * (away * normals[piece]).sum(axis=1)) / some
    surface_m = np.sqrt(d.sharp_m**2 + (d.gate_m**2 - d.sharp_m**2) / some)
    held = np.maximum(np.minimum(n_at / enough, 1), n_at / np.maximum(n_at + n_below, 1))
    beside = (n_at > 0) & (abs(offset) > surface_m)
    through = (n_below > 0) & (n_above < enough) & (held < 0.5)
    sight[(n_at > 0) & (held >= 0.5)] = SEEN
    sight[beside | through] = CONTRADICTED
    return sight


class _Hits:
    """Hits of one model, to be found by place."""

    def __init__(self, hits: Hits) -> None:
        self._hits = hits
        self._tree = KDTree(hits.points)

    def best_near(self, place: Vector, radius_m: float) -> F32 | None:
        """The hit (3,) of the highest correlation."""
        near = self._tree.query_ball_point(place, radius_m)
        if not near:
            return None
        return self._hits.points[near[int(np.argmax(self._hits.correlation[near]))]]


def _own_spin(world: F32, place: Vector | None, model: SpinImage | None, hits: _Hits | None) -> F32:
    """The spin image around the candidate's best hit, counted as the scan counts."""
    best = hits.best_near(place, model.radius_m) if place and model and hits else None
    if best is None or model is None:
        return np.empty((0, 0), np.float32)
    grid = SpinGrid.of(model.radius_m, model.height_m, model.bin_m)
    return spin_image(world, best, grid).astype(np.float32)
