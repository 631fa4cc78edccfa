"""Registration of a model to the points around a candidate in four upright degrees of freedom.

x, y, z and yaw, and where a model may stretch also its three extents. A coarse search over yaw and
offset, so that no start is missed, then iteratively reweighted Gauss-Newton on point-to-plane
residuals [Chen & Medioni 1992; Fitzgibbon 2003] from the best distinct starts to convergence.
All functions are compiled and work on one candidate; nothing is random.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

POSE = 7  # x, y, z, yaw, and the stretch along the object's x, y, z


@njit(cache=True, nogil=True, inline="always")
def nearest_sample(ux, uy, uz, ox, oy, oz, inv_voxel, nearest):
    """Index of the sample nearest to a point of the unstretched object frame, -1 off the grid."""
    i = int(math.floor((ux - ox) * inv_voxel))
    j = int(math.floor((uy - oy) * inv_voxel))
    k = int(math.floor((uz - oz) * inv_voxel))
    if i < 0 or j < 0 or k < 0:
        return -1
    if i >= nearest.shape[0] or j >= nearest.shape[1] or k >= nearest.shape[2]:
        return -1
    return nearest[i, j, k]


@njit(cache=True, nogil=True, inline="always")
def inside_depth(ux, uy, origin, inv_voxel, edges, depth_edge):
    """How far inside the outline a point of the unstretched object frame lies, metres.

    Negative outside; -inf off the grid.
    """
    i = int(math.floor((ux - origin[0]) * inv_voxel))
    j = int(math.floor((uy - origin[1]) * inv_voxel))
    if i < 0 or j < 0 or i >= depth_edge.shape[0] or j >= depth_edge.shape[1]:
        return -np.inf
    e = depth_edge[i, j]
    return edges[e, 2] * (edges[e, 0] - ux) + edges[e, 3] * (edges[e, 1] - uy)


@njit(cache=True, nogil=True)
def coarse_fit(
    points,
    weights,
    ground,
    ground_weights,
    samples,
    origin,
    voxel,
    nearest,
    footprint,
    size,
    pose,
    gate,
    enough,
):
    """How purely a pose explains what it claims, for comparing poses of a coarse search.

    Parameters
    ----------
    points : (N, 3) float64, world frame, above the ground.
    weights : (N,) float64.
    ground, ground_weights : (M, 3) and (M,) float64, points of the ground.
    samples, origin, voxel, nearest, footprint, size : of the ModelField.
    pose : (7,) float64.
    gate : residual at which a point stops being explained, metres.
    enough : weight of explained points that is convincing in itself.

    Returns
    -------
    float
        e / (e + u) * e / (e + enough), 0..1: e sums w (1 - d^2 / gate^2) over explained points, u
        the weight of unexplained points in the bounding box and of ground seen where the model
        would hide it. A sparsely sampled object fits as well as a dense one.
    """
    c, s = math.cos(pose[3]), math.sin(pose[3])
    sx, sy, sz = pose[4], pose[5], pose[6]
    half_x, half_y, top = size[0] / 2 * sx, size[1] / 2 * sy, size[2] * sz
    inv = 1.0 / voxel
    inv_gate2 = 1.0 / (gate * gate)
    explained = 0.0
    unexplained = 0.0
    for n in range(points.shape[0]):
        dx, dy = points[n, 0] - pose[0], points[n, 1] - pose[1]
        ux, uy, uz = c * dx + s * dy, c * dy - s * dx, points[n, 2] - pose[2]
        k = nearest_sample(ux / sx, uy / sy, uz / sz, origin[0], origin[1], origin[2], inv, nearest)
        if k < 0:
            continue
        ex, ey, ez = ux - sx * samples[k, 0], uy - sy * samples[k, 1], uz - sz * samples[k, 2]
        share = 1.0 - (ex * ex + ey * ey + ez * ez) * inv_gate2
        if share > 0.0:
            explained += weights[n] * share
        elif abs(ux) < half_x and abs(uy) < half_y and 0.0 < uz < top:
            unexplained += weights[n]
    for n in range(ground.shape[0]):
        dx, dy = ground[n, 0] - pose[0], ground[n, 1] - pose[1]
        i = int(math.floor(((c * dx + s * dy) / sx - origin[0]) * inv))
        j = int(math.floor(((c * dy - s * dx) / sy - origin[1]) * inv))
        if 0 <= i < footprint.shape[0] and 0 <= j < footprint.shape[1] and footprint[i, j]:
            unexplained += ground_weights[n]
    if explained <= 0.0:
        return 0.0
    return explained / (explained + unexplained) * explained / (explained + enough)


@njit(cache=True, nogil=True)
def hides_ground(ground, weights, edges, depth_edge, origin, voxel, pose, inset):
    """How much less ground is seen well inside the footprint than around it, 0..1.

    Near 1 the outline of the hole in the ground shows where the body stands, even one that returns
    next to no points itself; near 0 the scene shows what is below things too.
    """
    c, s = math.cos(pose[3]), math.sin(pose[3])
    inv = 1.0 / voxel
    inside = 0.0
    outside = 0.0
    area_inside = 0.0
    area_outside = 0.0
    for i in range(depth_edge.shape[0]):
        for j in range(depth_edge.shape[1]):
            e = depth_edge[i, j]
            x, y = origin[0] + (i + 0.5) * voxel, origin[1] + (j + 0.5) * voxel
            depth = edges[e, 2] * (edges[e, 0] - x) + edges[e, 3] * (edges[e, 1] - y)
            if depth > inset:
                area_inside += 1.0
            elif depth < 0.0:
                area_outside += 1.0
    for n in range(ground.shape[0]):
        dx, dy = ground[n, 0] - pose[0], ground[n, 1] - pose[1]
        ux, uy = (c * dx + s * dy) / pose[4], (c * dy - s * dx) / pose[5]
        depth = inside_depth(ux, uy, origin, inv, edges, depth_edge)
        if depth > inset:
            inside += weights[n]
        elif depth < 0.0 and depth > -np.inf:
            outside += weights[n]
    if outside <= 0.0 or area_inside <= 0.0 or area_outside <= 0.0:
        return 0.0
    return max(0.0, 1.0 - (inside / area_inside) / (outside / area_outside))


@njit(cache=True, nogil=True)
def refine(
    points,
    weights,
    ground,
    ground_weights,
    samples,
    normals,
    origin,
    voxel,
    nearest,
    edges,
    depth_edge,
    pose,
    gates,
    stretch,
    base_z,
    base_sd,
):
    """Gauss-Newton from one start, the gate narrowing from pass to pass.

    Parameters
    ----------
    points : (N, 3) float64, world frame, above the ground.
    weights : (N,) float64.
    ground, ground_weights : (M, 3) and (M,) float64. Ground seen inside the footprint pushes the
        footprint off itself, as far as the body hides the ground at all.
    samples, normals, origin, voxel, nearest, edges, depth_edge : of the ModelField.
    pose : (7,) float64, the start.
    gates : (G,) float64, residual gates of the passes, metres.
    stretch : largest relative stretch per axis, 0 for a rigid model.
    base_z, base_sd : where the base should stand and how sure that is, metres; ``base_sd`` <= 0
        leaves the height free.

    Returns
    -------
    pose : (7,) float64.
    converged : bool, the last step was below a thousandth of the gate.
    """
    pose = pose.copy()
    dof = POSE if stretch > 0.0 else 4
    inv = 1.0 / voxel
    converged = False
    reach = 0.0
    for k in range(samples.shape[0]):
        reach = max(reach, samples[k, 0] ** 2 + samples[k, 1] ** 2)
    reach = math.sqrt(reach)
    J = np.zeros(POSE)
    for g in range(gates.shape[0]):
        gate = gates[g]
        inv_gate2 = 1.0 / (gate * gate)
        inset = 0.5 * gates[-1]
        hides = hides_ground(
            ground, ground_weights, edges, depth_edge, origin, voxel, pose, gate + inset
        )
        for _ in range(12):
            A = np.zeros((dof, dof))
            b = np.zeros(dof)
            c, s = math.cos(pose[3]), math.sin(pose[3])
            sx, sy, sz = pose[4], pose[5], pose[6]
            total = 0.0
            for n in range(points.shape[0]):
                dx, dy = points[n, 0] - pose[0], points[n, 1] - pose[1]
                ux, uy, uz = c * dx + s * dy, c * dy - s * dx, points[n, 2] - pose[2]
                k = nearest_sample(
                    ux / sx, uy / sy, uz / sz, origin[0], origin[1], origin[2], inv, nearest
                )
                if k < 0:
                    continue
                ex = ux - sx * samples[k, 0]
                ey = uy - sy * samples[k, 1]
                ez = uz - sz * samples[k, 2]
                w = 1.0 - (ex * ex + ey * ey + ez * ez) * inv_gate2
                if w <= 0.0:
                    continue
                w = weights[n] * w * w  # Tukey's biweight
                nx, ny, nz = normals[k, 0] / sx, normals[k, 1] / sy, normals[k, 2] / sz
                norm = math.sqrt(nx * nx + ny * ny + nz * nz)
                nx, ny, nz = nx / norm, ny / norm, nz / norm
                r = nx * ex + ny * ey + nz * ez
                J[0] = -(c * nx - s * ny)
                J[1] = -(s * nx + c * ny)
                J[2] = -nz
                J[3] = nx * uy - ny * ux
                J[4] = -nx * samples[k, 0]
                J[5] = -ny * samples[k, 1]
                J[6] = -nz * samples[k, 2]
                total += w
                for i in range(dof):
                    b[i] -= w * J[i] * r
                    for j in range(i + 1):
                        A[i, j] += w * J[i] * J[j]
            if total <= 0.0:
                return pose, False
            for n in range(ground.shape[0]):
                if hides < 0.5:
                    break
                dx, dy = ground[n, 0] - pose[0], ground[n, 1] - pose[1]
                ux, uy = c * dx + s * dy, c * dy - s * dx
                i = int(math.floor((ux / sx - origin[0]) * inv))
                j = int(math.floor((uy / sy - origin[1]) * inv))
                if i < 0 or j < 0 or i >= depth_edge.shape[0] or j >= depth_edge.shape[1]:
                    continue
                e = depth_edge[i, j]
                nx, ny = edges[e, 2] / sx, edges[e, 3] / sy
                norm = math.sqrt(nx * nx + ny * ny)
                nx, ny = nx / norm, ny / norm
                # some ground is seen below an overhanging body: the last half gate is free
                r = nx * (sx * edges[e, 0] - ux) + ny * (sy * edges[e, 1] - uy) - inset
                if r <= 0.0 or r >= gate:
                    continue
                w = 1.0 - r * r * inv_gate2
                w = ground_weights[n] * hides * w * w
                J[0] = c * nx - s * ny
                J[1] = s * nx + c * ny
                J[2] = 0.0
                J[3] = ny * ux - nx * uy
                J[4] = nx * edges[e, 0]
                J[5] = ny * edges[e, 1]
                J[6] = 0.0
                for i in range(dof):
                    b[i] -= w * J[i] * r
                    for j in range(i + 1):
                        A[i, j] += w * J[i] * J[j]
            for i in range(dof):
                for j in range(i):
                    A[j, i] = A[i, j]
                # a little damping keeps a direction that no point sees where it is
                A[i, i] += 1e-4 * total * (reach * reach if i == 3 else 1.0)
            if base_sd > 0.0:
                # the ground counts as much as a tenth of the points
                pull = 0.1 * total * min(1.0, (gate / base_sd) ** 2)
                A[2, 2] += pull
                b[2] += pull * (base_z - pose[2])
            if stretch > 0.0:
                # prior: the stated bound is two standard deviations of the size
                prior = 0.02 * total * (gate / stretch) ** 2
                for i in range(4, POSE):
                    A[i, i] += prior
                    b[i] += prior * (1.0 - pose[i])
            step = np.linalg.solve(A, b)
            # no step beyond the gate: the correspondences would be others
            moved = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
            moved = max(moved, abs(step[3]) * reach)
            shrink = min(1.0, gate / moved) if moved > 0.0 else 1.0
            for i in range(dof):
                pose[i] += shrink * step[i]
            if stretch > 0.0:
                for i in range(4, POSE):
                    pose[i] = min(max(pose[i], 1.0 - stretch), 1.0 + stretch)
            converged = moved < 1e-3 * gate
            if converged:
                break
    return pose, converged
