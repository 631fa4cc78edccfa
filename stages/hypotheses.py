"""Hypotheses about candidates: compiled batches of coarse search, refinement and evidence.

Each candidate is worked on alone and by one thread, so neither the number of threads nor the other
candidates change its result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spinpipe.stages.evidence import (
    cells_within,
    model_evidence,
    outline_evidence,
    scene_evidence,
    side_evidence,
)
from spinpipe.stages.model_field import ModelField
from spinpipe.stages.registration import POSE, coarse_fit, refine
from spinpipe.stages.spin_kernel import map_threads
from spinpipe.stages.surroundings import Surroundings

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

EVIDENCE = (
    "converged",
    "supported",
    "contradicted",
    "empty",
    "covered",
    "sheltered",
    "claimed",
    "explained",
    "inside",
    "rms_m",
    "drop",
    "ring",
    "side_supported",
    "side_contradicted",
)
"""Columns of the evidence of a hypothesis, see ``evidence.py``."""

_COARSE_POINTS = 400
_FINE_POINTS = 1200
_CHUNK = 8


@dataclass(frozen=True)
class Tolerance:
    """What a fit of one model is judged by; all follow from model, density and noise.

    Attributes
    ----------
    gate_m : a point farther than this from the model's surface is not explained by it.
    sharp_m : the same without noise: how far the surface itself may be off.
    coarse_gate_m : the same during the coarse search, at least its step.
    step_m : offset between the starts of the coarse search.
    chance : share of the visible surface that a surface at a random height seems to support.
    headings : number of headings of the coarse search.
    offset_m : how far a candidate may lie from the model's topmost point.
    low_m : what is lower than this above the ground may be the ground.
    stretch : largest relative change of each extent.
    """

    gate_m: float
    sharp_m: float
    coarse_gate_m: float
    step_m: float
    chance: float
    headings: int
    offset_m: float
    low_m: float
    stretch: float


def tolerance(model: ModelField, stretch: float, spacing_m: float, noise_m: float) -> Tolerance:
    """Tolerances of a model in a cloud of given spacing and noise.

    The gate is three standard deviations of the noise, the spacing of the points and how badly the
    shape itself is known: a model that may stretch by a share of its size is known to that share
    of its narrow half extent, in quadrature.
    """
    narrow = model.narrow_m
    shape = stretch * narrow
    sharp = math.hypot(spacing_m, shape)
    gate = math.hypot(3 * noise_m, sharp)
    step = 0.3 * narrow
    # the mean of the points in a column, two spacings around a probe
    column = math.hypot(sharp, 3 * noise_m / math.sqrt(4 * math.pi))
    half_length = max(model.size[0], model.size[1]) / 2
    return Tolerance(
        gate_m=gate,
        sharp_m=sharp,
        coarse_gate_m=max(gate, step),
        step_m=step,
        chance=min(0.5, 2 * column / model.size[2]),
        headings=max(16, math.ceil(2 * math.pi * half_length / (3 * step))),
        offset_m=0.9 * narrow,
        low_m=max(3 * noise_m, 0.07 * model.size[2]),
        stretch=stretch,
    )


def coarse_poses(
    scene: Surroundings,
    model: ModelField,
    limits: Tolerance,
    places: F64,
    keep: int,
    threads: int,
) -> tuple[F64, F64]:
    """The best distinct coarse poses of a model at each candidate.

    Parameters
    ----------
    places : (C, 3), candidates: where the model's topmost point may be, world.
    keep : how many poses to keep of each.

    Returns
    -------
    poses : (C, keep, 7)
    gains : (C, keep), ``coarse_fit`` of each; 0 where there is no pose.
    """
    poses = np.zeros((len(places), keep, POSE))
    gains = np.zeros((len(places), keep))
    ground = scene.ground_at(places[:, :2])
    top = _top_xy(model)

    def work(part: slice) -> None:
        _coarse_batch(
            scene.points,
            scene.weights,
            scene.heights,
            scene.start,
            scene.cells,
            scene.corner,
            scene.cell_m,
            places[part],
            ground[part],
            top,
            model.samples,
            model.origin,
            model.voxel_m,
            model.nearest,
            model.footprint,
            model.size,
            limits.coarse_gate_m,
            limits.step_m,
            limits.headings,
            limits.offset_m,
            limits.low_m,
            limits.stretch,
            poses[part],
            gains[part],
        )

    for _ in map_threads(work, _parts(len(places)), threads):
        pass
    return poses, gains


def refine_poses(
    scene: Surroundings,
    model: ModelField,
    limits: Tolerance,
    starts: F64,
    threads: int,
) -> tuple[F64, F64]:
    """Register the model from each start to convergence and gather the evidence there.

    Parameters
    ----------
    starts : (S, 7)

    Returns
    -------
    poses : (S, 7)
    evidence : (S, len(EVIDENCE))
    """
    poses = starts.copy()
    evidence = np.zeros((len(starts), len(EVIDENCE)))
    ground = scene.ground_at(starts[:, :2])

    def work(part: slice) -> None:
        _refine_batch(
            scene.points,
            scene.weights,
            scene.heights,
            scene.start,
            scene.cells,
            scene.corner,
            scene.cell_m,
            scene.sampling.density,
            ground[part],
            model.samples,
            model.normals,
            model.probes,
            model.seen_weight,
            model.samples[model.side_probes],
            model.origin,
            model.voxel_m,
            model.nearest,
            model.solid,
            model.size,
            model.edges,
            model.depth_edge,
            model.outline,
            model.outline_normals,
            model.outline_height,
            limits.gate_m,
            limits.sharp_m,
            limits.coarse_gate_m,
            limits.low_m,
            limits.stretch,
            poses[part],
            evidence[part],
        )

    for _ in map_threads(work, _parts(len(starts)), threads):
        pass
    return poses, evidence


def shell_share(model: ModelField, gate_m: float) -> float:
    """Share of the volume a model claims that lies within ``gate_m`` of its surface.

    It is what points scattered at random over the claimed volume would seem to explain.
    """
    shape = model.nearest.shape
    axes = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    centres = model.origin + (np.stack(axes, -1) + 0.5) * model.voxel_m
    near = np.linalg.norm(centres - model.samples[model.nearest], axis=-1) < gate_m
    high = centres[..., 2] > 0.1 * model.size[2]
    box = (np.abs(centres[..., :2]) < model.size[:2] / 2).all(axis=-1)
    box &= centres[..., 2] < model.size[2]
    return float((near & high).sum() / ((near | box) & high).sum())


def _top_xy(model: ModelField) -> F64:
    """Horizontal position of the model's topmost surface, as the spin image takes it."""
    top = model.samples[model.samples[:, 2] > 0.99 * model.size[2]]
    return top[:, :2].mean(axis=0)


def _parts(count: int) -> list[slice]:
    return [slice(i, min(i + _CHUNK, count)) for i in range(0, count, _CHUNK)]


@njit(cache=True, nogil=True)
def _within(points, start, cells, corner, cell_m, x, y, radius):
    """Rows of the points within a horizontal distance."""
    i0, i1 = cells_within(x, radius, corner[0], cell_m, cells[0])
    j0, j1 = cells_within(y, radius, corner[1], cell_m, cells[1])
    total = 0
    for i in range(i0, i1):
        total += start[i * cells[1] + j1] - start[i * cells[1] + j0]
    rows = np.empty(total, np.int64)
    count = 0
    for i in range(i0, i1):
        for n in range(start[i * cells[1] + j0], start[i * cells[1] + j1]):
            dx, dy = points[n, 0] - x, points[n, 1] - y
            if dx * dx + dy * dy < radius * radius:
                rows[count] = n
                count += 1
    return rows[:count]


@njit(cache=True, nogil=True)
def _thin(points, weights, rows, count):
    """About ``count`` of the rows, evenly strided, with weights that keep their sum."""
    stride = max(1, (rows.shape[0] + count - 1) // count)
    n = (rows.shape[0] + stride - 1) // stride
    chosen = np.empty((n, 3))
    weight = np.empty(n)
    for k in range(n):
        chosen[k] = points[rows[k * stride]]
        weight[k] = weights[rows[k * stride]] * stride
    return chosen, weight


@njit(cache=True, nogil=True)
def _split(points, heights, rows, low, ceiling):
    """Rows that may belong to an object, and rows of the ground."""
    body = np.empty(rows.shape[0], np.int64)
    ground = np.empty(rows.shape[0], np.int64)
    bodies = 0
    grounds = 0
    for row in rows:
        if heights[row] <= low:
            ground[grounds] = row
            grounds += 1
        elif points[row, 2] < ceiling:
            body[bodies] = row
            bodies += 1
    return body[:bodies], ground[:grounds]


@njit(cache=True, nogil=True)
def _coarse_batch(
    points,
    weights,
    heights,
    start,
    cells,
    corner,
    cell_m,
    places,
    ground_z,
    top,
    samples,
    origin,
    voxel,
    nearest,
    footprint,
    size,
    gate,
    step,
    headings,
    offset,
    low,
    stretch,
    poses,
    gains,
):
    reach = math.hypot(size[0], size[1]) / 2 * (1 + stretch)
    keep = poses.shape[1]
    side = int(math.ceil(offset / step))
    count = headings * (2 * side + 1) ** 2
    # a tenth of the footprint, in cells of equal surface
    enough = 0.1 * size[0] * size[1] / (cell_m * cell_m)
    pose = np.empty((count, POSE))
    gain = np.empty(count)
    for c in range(places.shape[0]):
        x, y, z = places[c]
        rows = _within(points, start, cells, corner, cell_m, x, y, reach + offset + gate)
        ceiling = z + size[2] * stretch + 2 * gate
        body_rows, ground_rows = _split(points, heights, rows, low, ceiling)
        if body_rows.shape[0] < 10:
            continue
        body, body_weights = _thin(points, weights, body_rows, _COARSE_POINTS)
        ground, ground_weights = _thin(points, weights, ground_rows, _COARSE_POINTS)
        # where the model is rigid another one may have proposed the place: only its xy counts
        tall = 1.0
        base = ground_z[c]
        if stretch > 0.0:
            tall = min(max((z - ground_z[c]) / size[2], 1.0 - stretch), 1.0 + stretch)
            base = z - tall * size[2]
        n = 0
        for h in range(headings):
            yaw = 2 * math.pi * h / headings
            cos, sin = math.cos(yaw), math.sin(yaw)
            for i in range(-side, side + 1):
                for j in range(-side, side + 1):
                    ox, oy = i * step - top[0], j * step - top[1]
                    pose[n, 0] = x + cos * ox - sin * oy
                    pose[n, 1] = y + sin * ox + cos * oy
                    pose[n, 2] = base
                    pose[n, 3] = yaw
                    pose[n, 4] = 1.0
                    pose[n, 5] = 1.0
                    pose[n, 6] = tall
                    gain[n] = coarse_fit(
                        body,
                        body_weights,
                        ground,
                        ground_weights,
                        samples,
                        origin,
                        voxel,
                        nearest,
                        footprint,
                        size,
                        pose[n],
                        gate,
                        enough,
                    )
                    n += 1
        kept = 0
        for n in np.argsort(-gain, kind="mergesort"):
            if kept == keep or gain[n] <= 0.0:
                break
            distinct = True
            for k in range(kept):
                turn = abs((pose[n, 3] - poses[c, k, 3] + math.pi) % (2 * math.pi) - math.pi)
                shift = math.hypot(pose[n, 0] - poses[c, k, 0], pose[n, 1] - poses[c, k, 1])
                if turn < 2.1 * math.pi / headings and shift < 2.5 * step:
                    distinct = False
                    break
            if distinct:
                poses[c, kept] = pose[n]
                gains[c, kept] = gain[n]
                kept += 1


@njit(cache=True, nogil=True)
def _refine_batch(
    points,
    weights,
    heights,
    start,
    cells,
    corner,
    cell_m,
    density,
    ground_z,
    samples,
    normals,
    probes,
    seen_weight,
    sides,
    origin,
    voxel,
    nearest,
    solid,
    size,
    edges,
    depth_edge,
    outline,
    outline_normals,
    outline_height,
    gate,
    sharp,
    coarse_gate,
    low,
    stretch,
    poses,
    evidence,
):
    reach = math.hypot(size[0], size[1]) / 2 * (1 + stretch)
    probe_points = samples[probes]
    probe_normals = normals[probes]
    gates = np.array([coarse_gate, math.sqrt(coarse_gate * gate), gate])
    for c in range(poses.shape[0]):
        x, y, z = poses[c, 0], poses[c, 1], poses[c, 2]
        rows = _within(points, start, cells, corner, cell_m, x, y, reach + 2 * coarse_gate)
        ceiling = z + size[2] * (1 + 2 * stretch) + 2 * coarse_gate
        body_rows, ground_rows = _split(points, heights, rows, low, ceiling)
        if body_rows.shape[0] < 10:
            continue
        body, body_weights = _thin(points, weights, body_rows, _FINE_POINTS)
        ground, ground_weights = _thin(points, weights, ground_rows, _COARSE_POINTS)
        pose, converged = refine(
            body,
            body_weights,
            ground,
            ground_weights,
            samples,
            normals,
            origin,
            voxel,
            nearest,
            edges,
            depth_edge,
            poses[c],
            gates,
            stretch,
            ground_z[c],
            gate if stretch > 0.0 else 0.0,
        )
        poses[c] = pose
        supported, contradicted, empty, covered, sheltered = model_evidence(
            points,
            start,
            cells,
            cell_m,
            corner,
            probe_points,
            probe_normals,
            seen_weight,
            origin,
            voxel,
            edges,
            depth_edge,
            pose,
            gate,
            sharp,
            cell_m,
            density,
        )
        drop, ring = outline_evidence(
            points,
            start,
            cells,
            cell_m,
            corner,
            outline,
            outline_normals,
            outline_height,
            pose,
            gate + 0.7 * cell_m,
            0.7 * cell_m,
        )
        claimed, explained, inside, squares = scene_evidence(
            body,
            body_weights,
            samples,
            normals,
            origin,
            voxel,
            nearest,
            solid,
            size,
            pose,
            gate,
        )
        evidence[c, 0] = 1.0 if converged else 0.0
        evidence[c, 1] = supported
        evidence[c, 2] = contradicted
        evidence[c, 3] = empty
        evidence[c, 4] = covered
        evidence[c, 5] = sheltered
        evidence[c, 6] = claimed
        evidence[c, 7] = explained
        evidence[c, 8] = inside
        evidence[c, 9] = math.sqrt(squares / explained) if explained > 0.0 else np.inf
        evidence[c, 10] = drop
        evidence[c, 11] = ring
        evidence[c, 12], evidence[c, 13] = side_evidence(
            points,
            start,
            cells,
            cell_m,
            corner,
            sides,
            origin,
            voxel,
            edges,
            depth_edge,
            pose,
            gate,
            sharp,
            cell_m,
            density,
        )
