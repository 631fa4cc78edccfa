"""What speaks for and against a model at a pose: kernels that compare model and points both ways.

Terms: a visible sample of the model is *supported* where the scene has a surface, *contradicted*
where rays from above passed through it (points below, none at it, none above), *unobserved*
otherwise. A scene point is *claimed* when it lies in the model's bounding box and is not ground,
and *explained* when it lies on the model's surface.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from spinpipe.stages.registration import inside_depth, nearest_sample


@njit(cache=True, nogil=True, inline="always")
def cells_within(centre, reach, corner, pitch, cells):
    """First cell that a span touches along one axis and the one past its last.

    Equal where the span lies beside the grid: indices past its end would read foreign memory.
    """
    low = int(math.floor((centre - reach - corner) / pitch))
    high = int(math.floor((centre + reach - corner) / pitch)) + 1
    return min(max(low, 0), cells), min(max(high, 0), cells)


@njit(cache=True, nogil=True)
def model_evidence(
    points,
    cell_start,
    cells,
    cell_m,
    corner,
    samples,
    normals,
    seen_weight,
    origin,
    voxel,
    edges,
    depth_edge,
    pose,
    gate,
    sharp,
    column_m,
    density,
):
    """Share of the model's visible area that the scene supports and that it contradicts.

    Parameters
    ----------
    points : (N, 3) float64, world frame, ground included, sorted by cell.
    cell_start : (cx * cy + 1,) int64, first point of each cell of a square grid.
    cells : (2,) int64, cx and cy.
    cell_m, corner : pitch of that grid and the (x, y) of its corner, metres.
    samples, normals, seen_weight : probes of the ModelField.
    origin, voxel, edges, depth_edge : of the ModelField.
    pose : (7,) float64.
    gate : how far a point may lie from the model's surface, noise included, metres.
    sharp : how far the surface itself may lie from it, metres: the mean of n points may lie
        sqrt(sharp^2 + (gate^2 - sharp^2) / n) away.
    column_m : radius of the column looked at around a sample, metres.
    density : points per square metre around here.

    Returns
    -------
    supported, contradicted, empty, covered : shares of the visible area, together 1.
    sheltered : share of the visible area below some other surface, supported or not.
    """
    c, s = math.cos(pose[3]), math.sin(pose[3])
    supported = 0.0
    contradicted = 0.0
    empty = 0.0
    sheltered = 0.0
    # a quarter of the density around is enough to be a surface of its own right
    enough = 0.25 * density * math.pi * column_m * column_m
    enough = max(enough, 1.0)
    radius2 = column_m * column_m
    inv = 1.0 / voxel
    for k in range(samples.shape[0]):
        if seen_weight[k] <= 0.0:
            continue
        mx, my = samples[k, 0] * pose[4], samples[k, 1] * pose[5]
        x = pose[0] + c * mx - s * my
        y = pose[1] + s * mx + c * my
        z = pose[2] + samples[k, 2] * pose[6]
        # on a slope the surface within the column spans more height
        nz = max(normals[k, 2], 0.3)
        slope = math.sqrt(1.0 - nz * nz) / nz
        band = gate / nz
        i0, i1 = cells_within(x, column_m, corner[0], cell_m, cells[0])
        j0, j1 = cells_within(y, column_m, corner[1], cell_m, cells[1])
        at = 0
        below = 0
        height = 0.0
        above = 0
        for i in range(i0, i1):
            for n in range(cell_start[i * cells[1] + j0], cell_start[i * cells[1] + j1]):
                dx, dy = points[n, 0] - x, points[n, 1] - y
                if dx * dx + dy * dy > radius2:
                    continue
                dz = points[n, 2] - z
                if abs(dz) <= band + 0.5 * slope * column_m:
                    at += 1
                    height += dz
                elif dz < 0.0:
                    # what lies beside the body is no sight through it
                    dx, dy = points[n, 0] - pose[0], points[n, 1] - pose[1]
                    ux, uy = (c * dx + s * dy) / pose[4], (c * dy - s * dx) / pose[5]
                    if inside_depth(ux, uy, origin, inv, edges, depth_edge) > 0.5 * sharp:
                        below += 1
                else:
                    above += 1
        if above > 0:
            sheltered += seen_weight[k]
        if at > 0:
            held = max(min(at / enough, 1.0), at / (at + below))
            surface = math.sqrt(sharp * sharp + (gate * gate - sharp * sharp) / at) / nz
            if abs(height / at) > surface + 0.5 * slope * column_m:
                # a surface, but not this one
                contradicted += seen_weight[k]
                continue
        else:
            held = 0.0
        supported += seen_weight[k] * held
        if at + below + above == 0:
            empty += seen_weight[k]
        elif below > 0 and above == 0:
            contradicted += seen_weight[k] * (1.0 - held) * min(1.0, below / enough)
    covered = max(0.0, 1.0 - supported - contradicted - empty)
    return supported, contradicted, empty, covered, sheltered


@njit(cache=True, nogil=True)
def side_evidence(
    points,
    cell_start,
    cells,
    cell_m,
    corner,
    probes,
    origin,
    voxel,
    edges,
    depth_edge,
    pose,
    gate,
    sharp,
    column_m,
    density,
):
    """Share of the model's upright surface that the scene supports and that it contradicts.

    Whether upright surfaces are seen at all depends on where the sensor was. So nothing follows
    from one that is not there, unless points below it show that its place was looked through.

    Parameters
    ----------
    probes : (W, 3) float64, samples on upright surfaces, object frame.
    points, cell_start, cells, cell_m, corner, origin, voxel, edges, depth_edge, pose, gate, sharp,
    column_m, density : as in ``model_evidence``.

    Returns
    -------
    supported, contradicted : shares of the upright surface.
    """
    c, s = math.cos(pose[3]), math.sin(pose[3])
    inv = 1.0 / voxel
    reach = max(gate, column_m)
    enough = max(0.25 * density * math.pi * column_m * column_m, 1.0)
    supported = 0.0
    contradicted = 0.0
    for k in range(probes.shape[0]):
        mx, my = probes[k, 0] * pose[4], probes[k, 1] * pose[5]
        x = pose[0] + c * mx - s * my
        y = pose[1] + s * mx + c * my
        z = pose[2] + probes[k, 2] * pose[6]
        i0, i1 = cells_within(x, reach, corner[0], cell_m, cells[0])
        j0, j1 = cells_within(y, reach, corner[1], cell_m, cells[1])
        at = 0
        below = 0
        above = 0
        for i in range(i0, i1):
            for n in range(cell_start[i * cells[1] + j0], cell_start[i * cells[1] + j1]):
                dx, dy, dz = points[n, 0] - x, points[n, 1] - y, points[n, 2] - z
                flat2 = dx * dx + dy * dy
                if flat2 + dz * dz <= reach * reach:
                    at += 1
                elif flat2 <= column_m * column_m:
                    if dz > 0.0:
                        above += 1
                    else:
                        dx, dy = points[n, 0] - pose[0], points[n, 1] - pose[1]
                        ux, uy = (c * dx + s * dy) / pose[4], (c * dy - s * dx) / pose[5]
                        if inside_depth(ux, uy, origin, inv, edges, depth_edge) > sharp:
                            below += 1
        if at > 0:
            supported += 1.0
        elif below > 0 and above == 0:
            contradicted += min(1.0, below / enough)
    count = max(probes.shape[0], 1)
    return supported / count, contradicted / count


@njit(cache=True, nogil=True)
def outline_evidence(
    points, cell_start, cells, cell_m, corner, outline, normals, height, pose, beyond_m, column_m
):
    """How far the scene drops just outside the model's outline.

    A body ends where the model ends; a wall, a hedge or a roof that only contains the model's
    shape goes on.

    Parameters
    ----------
    points, cell_start, cells, cell_m, corner, pose, column_m : as in ``model_evidence``.
    outline, normals, height : of the ModelField.
    beyond_m : how far outside to look, metres.

    Returns
    -------
    drop : mean over the observed outline of (model height inside - scene height outside) / model
        height, each 0..1.
    observed : share of the outline with points outside it.
    """
    c, s = math.cos(pose[3]), math.sin(pose[3])
    radius2 = column_m * column_m
    total = 0.0
    observed = 0
    heights = np.empty(64)
    for k in range(outline.shape[0]):
        mx = outline[k, 0] * pose[4] + normals[k, 0] * beyond_m
        my = outline[k, 1] * pose[5] + normals[k, 1] * beyond_m
        x = pose[0] + c * mx - s * my
        y = pose[1] + s * mx + c * my
        i0, i1 = cells_within(x, column_m, corner[0], cell_m, cells[0])
        j0, j1 = cells_within(y, column_m, corner[1], cell_m, cells[1])
        inner = height[k] * pose[6]
        count = 0
        overhead = np.inf
        for i in range(i0, i1):
            for n in range(cell_start[i * cells[1] + j0], cell_start[i * cells[1] + j1]):
                dx, dy = points[n, 0] - x, points[n, 1] - y
                if dx * dx + dy * dy > radius2:
                    continue
                z = points[n, 2] - pose[2]
                if z > inner + beyond_m:
                    overhead = min(overhead, z)
                elif count < heights.shape[0]:
                    heights[count] = z
                    count += 1
        if count > 0:
            # the upper quartile: where the scene shows ground below things, things still go on
            level = np.sort(heights[:count])[(3 * count) // 4]
            total += min(max((inner - level) / inner, 0.0), 1.0)
        elif overhead > 2 * inner:
            continue  # a crown or a roof that hides what is below it
        observed += 1
    if observed == 0:
        return 0.0, 0.0
    return total / observed, observed / outline.shape[0]


@njit(cache=True, nogil=True)
def scene_evidence(
    points, weights, samples, normals, origin, voxel, nearest, solid, size, pose, gate
):
    """How much of what the model claims it also explains.

    Parameters
    ----------
    points, weights : (N, 3) and (N,) float64, points above the ground, world frame.
    samples, normals, origin, voxel, nearest, solid, size : of the ModelField.
    pose : (7,) float64.
    gate : metres.

    Returns
    -------
    claimed, explained, inside, square_sum : weights of points claimed, of those explained, of those
        deep inside the body, and the weighted sum of squared point-to-plane residuals of the
        explained ones, square metres.
    """
    c, s = math.cos(pose[3]), math.sin(pose[3])
    sx, sy, sz = pose[4], pose[5], pose[6]
    half_x, half_y, top = size[0] / 2 * sx, size[1] / 2 * sy, size[2] * sz
    inv = 1.0 / voxel
    claimed = 0.0
    explained = 0.0
    inside = 0.0
    square_sum = 0.0
    for n in range(points.shape[0]):
        dx, dy = points[n, 0] - pose[0], points[n, 1] - pose[1]
        ux, uy, uz = c * dx + s * dy, c * dy - s * dx, points[n, 2] - pose[2]
        if uz > top + gate or 0.0 <= uz < 0.1 * top:
            continue  # wheels, feet and what the ground piles up against them
        if abs(ux) > half_x + gate or abs(uy) > half_y + gate:
            continue
        k = nearest_sample(ux / sx, uy / sy, uz / sz, origin[0], origin[1], origin[2], inv, nearest)
        within = abs(ux) <= half_x and abs(uy) <= half_y and uz <= top
        if k < 0:
            # below the base, above the ground: the body goes on where the model does not
            claimed += weights[n] if within else 0.0
            continue
        ex, ey, ez = ux - sx * samples[k, 0], uy - sy * samples[k, 1], uz - sz * samples[k, 2]
        d2 = ex * ex + ey * ey + ez * ez
        if d2 <= gate * gate:
            nx, ny, nz = normals[k, 0] / sx, normals[k, 1] / sy, normals[k, 2] / sz
            r = (nx * ex + ny * ey + nz * ez) ** 2 / (nx * nx + ny * ny + nz * nz)
            claimed += weights[n]
            explained += weights[n]
            square_sum += weights[n] * r
        elif within:
            claimed += weights[n]
            i = int((ux / sx - origin[0]) * inv)
            j = int((uy / sy - origin[1]) * inv)
            m = int((uz / sz - origin[2]) * inv)
            if solid[i, j, m]:
                inside += weights[n]
    return claimed, explained, inside, square_sum
