"""Compiled batches of coarse search, refinement and evidence, see ``hypotheses``."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from spinpipe.stages.evidence import (
    cells_within,
    model_evidence,
    outline_evidence,
    scene_evidence,
    side_evidence,
)
from spinpipe.stages.registration import POSE, coarse_fit, refine

_COARSE_POINTS = 400
_FINE_POINTS = 1200


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
def coarse_batch(
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
    """Fill ``poses`` (C, K, 7) and ``gains`` (C, K) with the best coarse fits of each place.

    Every heading is tried at offsets of whole steps around the place; the other arguments are
    fields of ``Surroundings``, ``ModelField`` and ``Tolerance``, see ``hypotheses.coarse_poses``.
    """
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
def refine_batch(
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
    """Refine each of ``poses`` (S, 7) in place and fill its row of the evidence (S, E).

    The other arguments are fields of ``Surroundings``, ``ModelField`` and ``Tolerance``, see
    ``hypotheses.refine_poses``.
    """
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
