"""What things stand on: level surfaces under the sky, under roofs and bridges, on ramps and decks.

A column of the scene may hold several surfaces over one another. Each starts where, coming from
below, points begin after a gap. An object stands on one that passes near the height where its base
would be; how low the scene is elsewhere does not matter.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F64, I32, I64, Mask
from spinpipe.schemas.records import Sampling
from spinpipe.stages.compiled import inner, kept
from spinpipe.stages.geometry.columns import column_order

CELLS_PER_REACH = 5.0
"""Cells of the grid of surfaces along the reach within which support is looked for."""
CELL_SPACINGS = 6.0
"""Side of a cell, at least, in point spacings: 36 points on level ground."""
LOWEST_SHARE = 20
"""A surface's height in a cell is that of the lowest twentieth of its points."""
FULL_SHARE = 0.1
"""Points of a surface in a cell, at least, as a share of those on level ground: fewer are stray."""
SEEN_SHARE = 0.15
"""Share of the cells around that must show the surface: much of it may be covered. Chosen."""
STEEPEST = math.tan(math.radians(30.0))
"""Slope of a surface that things stand on, at most."""
SEED_SLOPES = (0.15, 0.35, 0.55)
"""Slopes from which the plane of a support is sought, in eight directions and level."""
ROUNDS = 4
"""Fits of the plane to what lies near it."""
BASE_SLACK = 0.15
"""How far a base may be off its support, as a share of the height above it: chosen."""


class Surfaces(NamedTuple):
    """Heights of the surfaces in the cells of a square grid; cell (i, j) is i * columns + j.

    ``start`` (rows * columns + 1,) is the first height of each cell in ``height``, ascending within
    a cell; ``seen`` counts the cells within the reach that show any.
    """

    start: I64
    height: F64
    seen: I32
    rows: int
    columns: int
    corner: F64
    side_m: float
    reach: int
    """Cells that the reach covers."""


class Support(NamedTuple):
    """The plane that an object stands on: z = height + slope_x (x - x0) + slope_y (y - y0).

    ``found`` is 0 where no surface passes near the base; the plane is then level, at the base.
    """

    height: F64
    slope_x: F64
    slope_y: F64
    found: F64


def reach_of(half_diagonal_m: float) -> float:
    """How far from an object's middle what it stands on is surely seen."""
    return 1.4 * half_diagonal_m


def support_halo_m(sampling: Sampling, reach_m: float) -> float:
    """How far around a place points must be known for its support to be right."""
    return reach_m + 3.0 * _side_m(sampling, reach_m)


def _side_m(sampling: Sampling, reach_m: float) -> float:
    return max(CELL_SPACINGS * sampling.spacing_m, reach_m / CELLS_PER_REACH)


def find_surfaces(xyz: F64, sampling: Sampling, reach_m: float, gap_m: float) -> Surfaces:
    """Surfaces that things may stand on.

    Parameters
    ----------
    xyz : (N, 3) world, metres; at least one.
    sampling : of the whole cloud.
    reach_m : how far from an object's middle its support is looked for.
    gap_m : height without points above which another surface begins.
    """
    side_m = _side_m(sampling, reach_m)
    order, first, keys, low, cells = column_order(xyz, side_m)
    rows, columns = int(cells[0]), int(cells[1])
    least = max(2, math.ceil(FULL_SHARE * sampling.density * side_m**2))
    start, height = _surfaces(
        np.ascontiguousarray(xyz[order, 2]), np.append(first, len(xyz)), keys, rows * columns,
        gap_m, least,
    )  # fmt: skip
    # a twentieth of the points lies about two standard deviations below the surface
    height += 2.0 * sampling.noise_m
    reach = math.ceil(reach_m / side_m)
    shown = (np.diff(start) > 0).reshape(rows, columns).astype(np.int32)
    seen = _box_sums(shown, reach)
    corner = np.asarray(low, np.float64) * side_m
    return Surfaces(start, height, seen, rows, columns, corner, side_m, reach)


def _box_sums(values: I32, reach: int) -> I32:
    """Sums over the square of ``2 reach + 1`` cells around each cell."""
    total = np.pad(values.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    rows, columns = (np.arange(n) for n in values.shape)
    low_i, high_i = (np.clip(rows + d, 0, values.shape[0]) for d in (-reach, reach + 1))
    low_j, high_j = (np.clip(columns + d, 0, values.shape[1]) for d in (-reach, reach + 1))
    sums = total[high_i][:, high_j] - total[low_i][:, high_j]
    sums = sums - total[high_i][:, low_j] + total[low_i][:, low_j]
    return sums.astype(np.int32, order="C")  # in any order else kernels are compiled for each


def has_support(points: NDArray[np.floating], surfaces: Surfaces, bands: F64) -> Mask:
    """Whether a surface lies at one of the depths (M, 2) below each of (N, 3) points, metres."""
    eligible = np.zeros(len(points), np.bool_)
    _has_support(np.asarray(points, np.float64), surfaces, bands, eligible)
    return eligible


def find_support(places: F64, base_m: F64, surfaces: Surfaces, slack_m: F64) -> Support:
    """The surface that an object at each place stands on.

    Parameters
    ----------
    places : (C, 3) world, metres; only x and y count.
    base_m : (C,) height where the object's base should be.
    surfaces : around all places.
    slack_m : (C,) how far from there it may be.
    """
    found = np.zeros((len(places), 4))
    _find_support(places, base_m, surfaces, slack_m, found)
    return Support(*found.T)


@kept("geometry")
def _surfaces(z, first, keys, cells, gap_m, least):
    start = np.zeros(cells + 1, np.int64)
    height = np.empty(len(z), np.float64)
    count = 0
    cell = 0
    for c in range(len(keys)):
        while cell <= keys[c]:
            start[cell] = count
            cell += 1
        begin = first[c]
        for n in range(first[c] + 1, first[c + 1] + 1):
            if n < first[c + 1] and z[n] - z[n - 1] <= gap_m:
                continue
            if n - begin >= least:
                height[count] = z[begin + (n - begin) // LOWEST_SHARE]
                count += 1
            begin = n
    while cell <= cells:
        start[cell] = count
        cell += 1
    return start, height[:count].copy()


@kept("geometry")
def _has_support(points, surfaces, bands, eligible):
    for n in range(points.shape[0]):
        i, j = _cell(surfaces, points[n, 0], points[n, 1])
        needed = max(1.0, SEEN_SHARE * surfaces.seen[i, j])
        z = points[n, 2]
        for m in range(bands.shape[0]):
            if _count(surfaces, i, j, z - bands[m, 1], z - bands[m, 0], needed) >= needed:
                eligible[n] = True
                break


@kept("geometry")
def _find_support(places, base_m, surfaces, slack_m, found):
    for c in range(places.shape[0]):
        _support_plane(places[c, 0], places[c, 1], base_m[c], surfaces, slack_m[c], found[c])


@inner
def _cell(surfaces, x, y):
    i = int(math.floor((x - surfaces.corner[0]) / surfaces.side_m))
    j = int(math.floor((y - surfaces.corner[1]) / surfaces.side_m))
    return min(max(i, 0), surfaces.rows - 1), min(max(j, 0), surfaces.columns - 1)


@inner
def _count(surfaces, i, j, low, high, enough):
    """Cells around (i, j) with a surface between two heights; no more than enough are counted."""
    count = 0
    for a in range(max(i - surfaces.reach, 0), min(i + surfaces.reach + 1, surfaces.rows)):
        for b in range(max(j - surfaces.reach, 0), min(j + surfaces.reach + 1, surfaces.columns)):
            cell = a * surfaces.columns + b
            for k in range(surfaces.start[cell], surfaces.start[cell + 1]):
                if low <= surfaces.height[k] <= high:
                    count += 1
                    break
        if count >= enough:
            break
    return count


@inner
def _support_plane(x, y, base, surfaces, slack, found):
    """Fill (height, slope x, slope y, found) of the plane near the base that most cells lie on."""
    i, j = _cell(surfaces, x, y)
    near = _near(surfaces, i, j, x, y, base, slack)
    found[0], found[1], found[2], found[3] = base, 0.0, 0.0, 0.0
    if near.shape[0] == 0:
        return
    reach2 = (surfaces.reach * surfaces.side_m) ** 2
    best, seed_x, seed_y = _agreement(near, base, 0.0, 0.0, slack, reach2), 0.0, 0.0
    for slope in SEED_SLOPES:
        for k in range(8):
            a, b = slope * math.cos(k * math.pi / 4), slope * math.sin(k * math.pi / 4)
            value = _agreement(near, base, a, b, slack, reach2)
            if value > 1.1 * best:
                best, seed_x, seed_y = value, a, b
    if best <= 0.0:
        return
    z, a, b = base, seed_x, seed_y
    for _ in range(ROUNDS):
        z, a, b = _refit(near, z, a, b, slack, reach2)
    if abs(z - base) > 2.0 * slack:
        return
    found[0], found[1], found[2], found[3] = z, a, b, 1.0


@inner
def _near(surfaces, i, j, x, y, base, slack):
    """(K, 3) offsets from (x, y) and heights of the surfaces around that a plane may pass."""
    reach = surfaces.reach
    low_i, high_i = max(i - reach, 0), min(i + reach + 1, surfaces.rows)
    low_j, high_j = max(j - reach, 0), min(j + reach + 1, surfaces.columns)
    total = 0
    for a in range(low_i, high_i):
        row = a * surfaces.columns
        total += surfaces.start[row + high_j] - surfaces.start[row + low_j]
    near = np.empty((total, 3))
    count = 0
    for a in range(low_i, high_i):
        for b in range(low_j, high_j):
            cell = a * surfaces.columns + b
            dx = surfaces.corner[0] + (a + 0.5) * surfaces.side_m - x
            dy = surfaces.corner[1] + (b + 0.5) * surfaces.side_m - y
            most = slack + STEEPEST * math.hypot(dx, dy)
            for k in range(surfaces.start[cell], surfaces.start[cell + 1]):
                if abs(surfaces.height[k] - base) <= most:
                    near[count, 0], near[count, 1], near[count, 2] = dx, dy, surfaces.height[k]
                    count += 1
    return near[:count]


@inner
def _agreement(near, z, a, b, slack, reach2):
    """Weight of the cells near a plane: nearer ones count more."""
    total = 0.0
    for k in range(near.shape[0]):
        dx, dy = near[k, 0], near[k, 1]
        r = (near[k, 2] - z - a * dx - b * dy) / slack
        if abs(r) < 1.0:
            total += (1.0 - r * r) / (1.0 + 4.0 * (dx * dx + dy * dy) / reach2)
    return total


@inner
def _refit(near, z, a, b, slack, reach2):
    """The plane again, by weighted least squares over what lies near it.

    The slope is damped as if a few cells were known to be level: a plane that few cells tell of
    stays level.
    """
    A, v = np.zeros((3, 3)), np.zeros(3)
    total = 0.0
    for k in range(near.shape[0]):
        dx, dy = near[k, 0], near[k, 1]
        r = (near[k, 2] - z - a * dx - b * dy) / slack
        if abs(r) >= 1.0:
            continue
        w = (1.0 - r * r) ** 2 / (1.0 + 4.0 * (dx * dx + dy * dy) / reach2)
        total += w
        A[0, 0] += w
        A[0, 1] += w * dx
        A[0, 2] += w * dy
        A[1, 1] += w * dx * dx
        A[1, 2] += w * dx * dy
        A[2, 2] += w * dy * dy
        v[0] += w * near[k, 2]
        v[1] += w * dx * near[k, 2]
        v[2] += w * dy * near[k, 2]
    if total <= 0.0:
        return z, a, b
    damping = 0.05 * reach2
    A[1, 1] += damping
    A[2, 2] += damping
    A[1, 0], A[2, 0], A[2, 1] = A[0, 1], A[0, 2], A[1, 2]
    plane = np.linalg.solve(A, v)
    slope = math.hypot(plane[1], plane[2])
    shrink = min(1.0, STEEPEST / slope) if slope > 0.0 else 1.0
    return plane[0], shrink * plane[1], shrink * plane[2]
