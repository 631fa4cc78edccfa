"""Joint resolution: no two instances stand in the same place, the better explanation stays."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F64, I64

Corner: TypeAlias = tuple[float, float]

MAX_OVERLAP = 0.25
"""Share of the smaller body that two instances may have in common: fits are not exact."""
MAX_TAKEN = 0.4
"""Share of a body that all others together may take: chosen, less than two neighbours at the limit.
What lies across a row takes little of each of its members."""


def resolve(
    poses: F64,
    sizes: F64,
    scores: F64,
    max_overlap: float = MAX_OVERLAP,
    candidate: I64 | None = None,
) -> I64:
    """Which hypothesis displaces each one.

    Taken from the best score downwards, a hypothesis stays if its body overlaps no body that
    stayed before it by more than ``max_overlap`` of the smaller of the two, and all of them by no
    more than ``MAX_TAKEN`` of its own.

    Parameters
    ----------
    poses : (S, 4) float64: x, y, z of the base centre and yaw, world.
    sizes : (S, 3) float64, fitted extents along the object's axes, metres.
    scores : (S,) float64; equal scores are taken in the order of their positions.
    candidate : (S,) whose hypothesis each is: of one candidate only one stays.

    Returns
    -------
    (S,) int64
        -1 where the hypothesis stays, else the row of the best one that displaces it, or of the
        one that takes most of it.
    """
    displaced_by = np.full(len(poses), -1, dtype=np.int64)
    if len(poses) == 0:
        return displaced_by
    tree = KDTree(poses[:, :2])
    reach = np.hypot(sizes[:, 0], sizes[:, 1]) / 2
    farthest = reach.max()
    stays = np.zeros(len(poses), dtype=bool)
    stands: dict[int, int] = {}
    for row in np.lexsort((poses[:, 1], poses[:, 0], -scores)):
        own = row if candidate is None else int(candidate[row])
        if own in stands:
            displaced_by[row] = stands[own]
            continue
        near = tree.query_ball_point(poses[row, :2], reach[row] + farthest)
        rivals = sorted((k for k in near if stays[k]), key=lambda k: -scores[k])
        common = [common_m3(poses[row], sizes[row], poses[k], sizes[k]) for k in rivals]
        for rival, volume in zip(rivals, common, strict=True):
            if volume > max_overlap * min(sizes[row].prod(), sizes[rival].prod()):
                displaced_by[row] = rival
                break
        else:
            if sum(common) > max(MAX_TAKEN, max_overlap) * sizes[row].prod():
                displaced_by[row] = rivals[int(np.argmax(common))]
            else:
                stays[row] = True
                stands[own] = row
    return displaced_by


def common_m3(pose_a: F64, size_a: F64, pose_b: F64, size_b: F64) -> float:
    """Common volume of two upright boxes, cubic metres.

    Parameters
    ----------
    pose_a, pose_b : (4,) x, y, z of the base centre and yaw.
    size_a, size_b : (3,) extents.
    """
    common = min(pose_a[2] + size_a[2], pose_b[2] + size_b[2]) - max(pose_a[2], pose_b[2])
    if common <= 0:
        return 0.0
    return common * _convex_area(_clip(_corners(pose_a, size_a), _corners(pose_b, size_b)))


def _corners(pose: F64, size: F64) -> list[Corner]:
    """The footprint's four, counter-clockwise."""
    x, y, _, yaw = pose.tolist()
    cos, sin = math.cos(yaw) / 2, math.sin(yaw) / 2
    ux, uy = cos * float(size[0]), sin * float(size[0])
    vx, vy = -sin * float(size[1]), cos * float(size[1])
    return [
        (x + ux + vx, y + uy + vy),
        (x - ux + vx, y - uy + vy),
        (x - ux - vx, y - uy - vy),
        (x + ux - vx, y + uy - vy),
    ]


def _clip(polygon: list[Corner], window: list[Corner]) -> list[Corner]:
    """Part of a convex polygon inside another [Sutherland & Hodgman 1974]; plain numbers: fast."""
    for k, (ax, ay) in enumerate(window):
        bx, by = window[(k + 1) % len(window)]
        side = [(bx - ax) * (y - ay) - (by - ay) * (x - ax) for x, y in polygon]
        kept: list[Corner] = []
        for n, ((px, py), d) in enumerate(zip(polygon, side, strict=True)):
            (qx, qy), e = polygon[n - 1], side[n - 1]
            if (d >= 0) != (e >= 0):
                t = e / (e - d)
                kept.append((qx + (px - qx) * t, qy + (py - qy) * t))
            if d >= 0:
                kept.append((px, py))
        polygon = kept
    return polygon


def _convex_area(polygon: list[Corner]) -> float:
    """Shoelace formula."""
    following = polygon[1:] + polygon[:1]
    pairs = zip(polygon, following, strict=True)
    return abs(sum(x * v - y * u for (x, y), (u, v) in pairs)) / 2
