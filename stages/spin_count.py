"""Inner loops of the spin scan, compiled: runs of a block, windows of heights, bins, counts.

All comparisons are made in float32 with the very expressions of the numpy twin ``spin_image``.
Rounding never swaps two numbers, so a bound that fails for the nearest corner of a cell, or for
its lowest or highest point, fails for every point of the cell: skipping is exact.
"""

from __future__ import annotations

import numpy as np
from numba import njit

LANES = 16
"""Points binned at once, and idle counters over which points outside the image are spread."""
BUFFER = 4096
"""Bin numbers held between binning and counting."""
COPIES = 4
"""Interleaved histograms: the same counter is rarely needed before its last store is done."""
SLACK = 1e-5
"""Relative widening of the search for cells, far above the rounding of float32."""


@njit(cache=True, nogil=True)
def first_not_above(z, start, end, level):
    """First of the ascending ``z[start:end]`` for which ``level - z > 0`` fails."""
    while start < end:
        mid = (start + end) >> 1
        if level - z[mid] > np.float32(0):
            start = mid + 1
        else:
            end = mid
    return start


@njit(cache=True, nogil=True)
def first_within(z, start, end, level, height):
    """First of the ascending ``z[start:end]`` for which ``level - z < height`` holds."""
    while start < end:
        mid = (start + end) >> 1
        if level - z[mid] < height:
            end = mid
        else:
            start = mid + 1
    return start


@njit(cache=True, nogil=True)
def collect_runs(xyz, start, key, bounds, corner, cells, cell_m, box, radius, height, runs, limits):
    """Collect the runs of points that origins inside ``box`` can reach; return their number.

    ``box`` holds the least and greatest x, y and z of the origins (float32). Fills ``runs``
    (2, cap) with first and past-last point and ``limits`` (6, cap) with the cells' bounds.
    """
    z = xyz[2]
    reach = np.float64(radius) * (1.0 + SLACK) + 1e-9 * cell_m * max(cells[0], cells[1])
    x0, x1 = np.float64(box[0]) - corner[0], np.float64(box[1]) - corner[0]
    y0, y1 = np.float64(box[2]) - corner[1], np.float64(box[3]) - corner[1]
    found = 0
    first_ix = max(np.floor((x0 - reach) / cell_m), 0.0)
    last_ix = min(np.floor((x1 + reach) / cell_m), cells[0] - 1.0)
    ix = np.int64(first_ix)
    while ix <= last_ix:
        gap = max(max(ix * cell_m - x1, x0 - (ix + 1) * cell_m), 0.0)
        half = np.sqrt(max(reach * reach - gap * gap, 0.0)) + SLACK * reach
        first_iy = max(np.floor((y0 - half) / cell_m), 0.0)
        last_iy = min(np.floor((y1 + half) / cell_m), cells[1] - 1.0)
        if first_iy <= last_iy:
            last_key = ix * cells[1] + np.int64(last_iy)
            c = np.searchsorted(key, ix * cells[1] + np.int64(first_iy))
            while c < len(key) and key[c] <= last_key:
                low, high = bounds[4, c], bounds[5, c]
                if box[5] - low > np.float32(0) and box[4] - high < height:
                    begin = first_within(z, start[c], start[c + 1], box[4], height)
                    end = first_not_above(z, begin, start[c + 1], box[5])
                    if begin < end:
                        runs[0, found], runs[1, found] = begin, end
                        for side in range(4):
                            limits[side, found] = bounds[side, c]
                        limits[4, found], limits[5, found] = z[begin], z[end - 1]
                        found += 1
                c += 1
        ix += 1
    return found


@njit(cache=True, nogil=True)
def bin_points(x, y, z, ox, oy, oz, radius_sq, scale, cols, outside, numbers):
    """Bin number of each point, ``outside + lane`` for those beyond the radius (vectorised)."""
    for j in range(len(x)):
        dx = x[j] - ox
        dy = y[j] - oy
        a2 = dx * dx + dy * dy
        col = np.int32(np.sqrt(a2) * scale)
        row = np.int32((oz - z[j]) * scale)
        number = row * cols + col
        numbers[j] = np.uint16(number if a2 < radius_sq else outside + np.int32(j & (LANES - 1)))


@njit(cache=True, nogil=True)
def count_numbers(numbers, counts):
    """Add the bin numbers to the interleaved histograms ``counts`` (COPIES, bins)."""
    h0, h1, h2, h3 = counts[0], counts[1], counts[2], counts[3]
    n = len(numbers)
    whole = n - n % 4
    for j in range(0, whole, 4):
        h0[numbers[j]] += np.uint32(1)
        h1[numbers[j + 1]] += np.uint32(1)
        h2[numbers[j + 2]] += np.uint32(1)
        h3[numbers[j + 3]] += np.uint32(1)
    for j in range(whole, n):
        h0[numbers[j]] += np.uint32(1)


@njit(cache=True, nogil=True)
def count_origin(
    xyz, runs, limits, found, near, ox, oy, oz, radius_sq, height, scale, cols, bins, numbers,
    counts, image,
):  # fmt: skip
    """Spin image of one origin into ``image`` (bins,) uint32; returns the points visited."""
    x, y, z = xyz[0], xyz[1], xyz[2]
    zero = np.float32(0)
    for r in range(found):
        dx = max(max(limits[0, r] - ox, ox - limits[1, r]), zero)
        dy = max(max(limits[2, r] - oy, oy - limits[3, r]), zero)
        near[r] = dx * dx + dy * dy
    counts[:, :] = 0
    visits = 0
    held = 0
    for r in range(found):
        if near[r] >= radius_sq or not (oz - limits[4, r] > zero and oz - limits[5, r] < height):
            continue
        begin, end = runs[0, r], runs[1, r]
        if oz - limits[4, r] >= height:
            begin = first_within(z, begin, end, oz, height)
        if not oz - limits[5, r] > zero:
            end = first_not_above(z, begin, end, oz)
        visits += end - begin
        while begin < end:
            n = min(end - begin, BUFFER - held)
            lanes = (n + LANES - 1) // LANES * LANES
            bin_points(
                x[begin : begin + lanes], y[begin : begin + lanes], z[begin : begin + lanes],
                ox, oy, oz, radius_sq, scale, cols, bins, numbers[held : held + lanes],
            )  # fmt: skip
            begin += n
            held += n
            if held == BUFFER:
                count_numbers(numbers[:held], counts)
                held = 0
    count_numbers(numbers[:held], counts)
    for i in range(bins):
        image[i] = counts[0, i] + counts[1, i] + counts[2, i] + counts[3, i]
    return visits
