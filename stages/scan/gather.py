"""What a block of origins can reach, gathered and ordered by depth; compiled.

Neighbouring origins share their search: the points that any of them can reach are gathered once,
ordered by depth, so that what one origin sees of them is a contiguous run.

All comparisons are made in float32 with the very expressions of the numpy twin ``spin_image``.
Rounding never swaps two numbers, so a bound that fails for the nearest corner of a box fails for
every point in the box: skipping is exact.
"""
# pyright: basic

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spinpipe.schemas.arrays import F32, I64
from spinpipe.stages.compiled import inlined, inner

LANES = 16
"""Points handled at once by the vectorised loops; runs are read in whole multiples."""
SEARCH_SLACK = 1e-5
"""Relative widening of the search for cells, far above the rounding of float32."""
BUCKETS = 512
"""Steps of the order by depth."""
ORDER_FROM = 8
"""Least origins of a block for which ordering by depth pays."""
PLACES = 2
"""Counters of a bucket, used in turn."""
PAD = 64
"""Points readable past the end of a run."""


class Nearby(NamedTuple):
    """Points that a block of origins can reach, ordered by buckets of depth.

    ``first[i]`` is the first point of bucket i; bucket ``int((top - z) * per_m)``. ``lowest[i]`` is
    the least height in it, NaN until it is asked for.
    """

    x: F32
    y: F32
    z: F32
    first: I64
    lowest: F32
    top: np.float32
    per_m: np.float32


@inner
def bounding_box(origins):
    """Return the least and greatest x, y, z of origins: (6,) float32."""
    box = np.empty(6, np.float32)
    for axis in range(3):
        low = high = origins[0, axis]
        for o in range(len(origins)):
            low = min(low, origins[o, axis])
            high = max(high, origins[o, axis])
        box[2 * axis], box[2 * axis + 1] = low, high
    return box


@inner
def fill(line, value):
    """Set all of a line."""
    for i in range(len(line)):
        line[i] = value


@inner
def _first_at_least(ascending, begin, value):
    """Find the first element from ``begin`` on that is not less than ``value``."""
    end = len(ascending)
    while begin < end:
        mid = (begin + end) >> 1
        if ascending[mid] < value:
            begin = mid + 1
        else:
            end = mid
    return begin


@inner
def _window(z, begin, end, low, high, height):
    """Narrow the ascending ``z[begin:end]`` to what origins between ``low`` and ``high`` see."""
    last = end
    while begin < last:  # first with low - z < height
        mid = (begin + last) >> 1
        if low - z[mid] < height:
            last = mid
        else:
            begin = mid + 1
    first = begin
    while begin < end:  # first without high - z > 0
        mid = (begin + end) >> 1
        if high - z[mid] > np.float32(0):
            begin = mid + 1
        else:
            end = mid
    return first, end


@inner
def _collect_runs(index, box, radius, height):
    """Find the runs of points that origins inside ``box`` may reach: their number, (2, cap)."""
    z = index.xyz[2]
    cell_m, nx, ny = index.cell_m, index.cells[0], index.cells[1]
    reach = radius * (1.0 + SEARCH_SLACK) + 1e-9 * cell_m * max(nx, ny)
    x0, x1 = np.float64(box[0]) - index.corner[0], np.float64(box[1]) - index.corner[0]
    y0, y1 = np.float64(box[2]) - index.corner[1], np.float64(box[3]) - index.corner[1]
    runs = np.empty((2, 16), np.int64)
    found = 0
    last_ix = min(np.floor((x1 + reach) / cell_m), nx - 1.0)
    first_ix = min(max(np.floor((x0 - reach) / cell_m), 0.0), np.float64(nx))
    c = _first_at_least(index.key, 0, np.int64(first_ix) * ny)
    while c < len(index.key):  # row by row, empty ones left out
        ix = index.key[c] // ny
        if ix > last_ix:
            break
        gap = max(max(ix * cell_m - x1, x0 - (ix + 1) * cell_m), 0.0)
        half = np.sqrt(max(reach * reach - gap * gap, 0.0)) + SEARCH_SLACK * reach
        first_iy = min(max(np.floor((y0 - half) / cell_m), 0.0), np.float64(ny))
        last_iy = min(np.floor((y1 + half) / cell_m), ny - 1.0)
        if first_iy <= last_iy:
            last_key = ix * ny + np.int64(last_iy)
            c = _first_at_least(index.key, c, ix * ny + np.int64(first_iy))
            while c < len(index.key) and index.key[c] <= last_key:
                if box[5] - index.bounds[4, c] > np.float32(0) and (
                    box[4] - index.bounds[5, c] < height
                ):
                    begin, end = _window(
                        z, index.start[c], index.start[c + 1], box[4], box[5], height
                    )
                    if begin < end:
                        if found == runs.shape[1]:
                            longer = np.empty((2, 2 * found), np.int64)
                            for r in range(found):
                                longer[0, r], longer[1, r] = runs[0, r], runs[1, r]
                            runs = longer
                        runs[0, found], runs[1, found] = begin, end
                        found += 1
                c += 1
        c = _first_at_least(index.key, c, (ix + 1) * ny)
    return found, runs


@inner
def _number_buckets(x, y, z, box, radius_sq, per_m, numbers):
    """Find each point's bucket of depth; BUCKETS for those out of reach of ``box`` (vectorised)."""
    x0, x1, y0, y1, top = box[0], box[1], box[2], box[3], box[5]
    zero, last = np.float32(0), np.float32(BUCKETS - 1)
    for j in range(len(x)):
        dx = max(max(x0 - x[j], x[j] - x1), zero)
        dy = max(max(y0 - y[j], y[j] - y1), zero)
        bucket = np.int32(min((top - z[j]) * per_m, last))
        numbers[j] = bucket if dx * dx + dy * dy < radius_sq else np.int32(BUCKETS)


@inner
def gather(index, box, radius_sq, height, origins):
    """Gather what ``origins`` many origins inside ``box`` can reach: ``Nearby``."""
    x, y, z = index.xyz[0], index.xyz[1], index.xyz[2]
    found, runs = _collect_runs(index, box, np.sqrt(np.float64(radius_sq)), height)
    total = 0
    for r in range(found):
        total += runs[1, r] - runs[0, r]
    near = np.empty((3, total + PAD), np.float32)
    u, v, w = near[0], near[1], near[2]
    for axis in range(3):
        fill(near[axis, total:], np.float32(0))
    first = np.empty(BUCKETS + 1, np.int64)
    lowest = np.empty(BUCKETS, np.float32)
    fill(lowest, np.float32(np.nan))
    n = 0
    if origins < ORDER_FROM:  # one bucket holds all
        for r in range(found):
            begin, end = runs[0, r], runs[1, r]
            for j in range(begin, end):
                u[n], v[n], w[n] = x[j], y[j], z[j]
                n += 1
        fill(first, total)
        first[0] = 0
        return Nearby(u, v, w, first, lowest, box[5], np.float32(0))
    per_m = np.float32((BUCKETS - 1) / (np.float64(box[5]) - np.float64(box[4]) + height))
    numbers = np.empty(total + PAD, np.int32)
    for r in range(found):
        begin, end = runs[0, r], runs[1, r]
        whole = (end - begin + LANES - 1) // LANES * LANES
        _number_buckets(
            x[begin : begin + whole], y[begin : begin + whole], z[begin : begin + whole],
            box, radius_sq, per_m, numbers[n : n + whole],
        )  # fmt: skip
        n += end - begin
    # Neighbours in a run share buckets: counters in turn wait less for their last store.
    place = np.empty((PLACES, BUCKETS + 1), np.int32)
    for turn in range(PLACES):
        fill(place[turn], 0)
    for j in range(total):
        place[j & (PLACES - 1), np.uint32(numbers[j])] += 1
    at = np.int32(0)
    for bucket in range(BUCKETS + 1):
        first[bucket] = at
        for turn in range(PLACES):
            count = place[turn, bucket]
            place[turn, bucket] = at
            at += count
    n = 0
    for r in range(found):
        for j in range(runs[0, r], runs[1, r]):
            turn, bucket = n & (PLACES - 1), np.uint32(numbers[n])
            to = np.uint64(place[turn, bucket])
            place[turn, bucket] += 1
            u[to], v[to], w[to] = x[j], y[j], z[j]
            n += 1
    return Nearby(u, v, w, first, lowest, box[5], per_m)


@inner
def _lowest(near, bucket):
    """Find the least height in a bucket, infinite if it is empty."""
    if np.isnan(near.lowest[bucket]):
        least = np.float32(np.inf)
        for j in range(near.first[bucket], near.first[bucket + 1]):
            least = min(least, near.z[j])
        near.lowest[bucket] = least
    return near.lowest[bucket]


@inlined
def depth_window(near, low, high, height):
    """Find the gathered points that hold all an origin between ``low`` and ``high`` can see."""
    if near.per_m == 0:  # not ordered
        return near.first[0], near.first[BUCKETS]
    last = np.float32(BUCKETS - 1)
    begin = np.int64(min((near.top - high) * near.per_m, last))
    if not high - _lowest(near, begin) > np.float32(0):  # level ground: none of them is below
        begin += 1
    end = np.int64(min((near.top - low + height) * near.per_m, last)) + 2  # one for rounding
    return near.first[begin], near.first[min(end, BUCKETS)]
