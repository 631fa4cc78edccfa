"""Inner loops of the spin scan, compiled: what a block of origins can reach, bins, counts.

A block of neighbouring origins gathers the points that any of them can reach, ordered by depth,
so that each origin's window of heights is one contiguous run. The run is taken in two loops:
first the bin numbers (vectorised), then the counting.

All comparisons are made in float32 with the very expressions of the numpy twin ``spin_image``.
Rounding never swaps two numbers, so a bound that fails for the nearest corner of a box fails for
every point in the box: skipping is exact.
"""
# pyright: basic

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spinpipe.stages.spin_image import FLAT_VARIANCE

inner = njit(
    nogil=True,
    error_model="numpy",
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
)
"""Compiles what only other kernels call; ``spin_scan`` caches the outermost ones."""

LANES = 16
"""Idle counters over which points outside the image are spread."""
BUFFER = 1024
"""Bin numbers held between binning and counting."""
COPIES = 4
"""Interleaved histograms: the same counter is rarely needed before its last store is done."""
SLACK = 1e-5
"""Relative widening of the search for cells, far above the rounding of float32."""
BUCKETS = 512
"""Steps of the order by depth."""
ORDER_FROM = 8
"""Least origins of a block for which ordering by depth pays."""
PAD = 64
"""Points readable past the end of a run."""


class IndexArrays(NamedTuple):
    """The arrays of a ``SpinIndex``."""

    xyz: Any
    start: Any
    key: Any
    bounds: Any
    corner: Any
    cells: Any
    cell_m: Any


class Nearby(NamedTuple):
    """Points that a block of origins can reach, ordered by buckets of depth.

    ``first[i]`` is the first point of bucket i; bucket ``int((top - z) * per_m)``.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    z: NDArray[np.float32]
    first: NDArray[np.int64]
    top: np.float32
    per_m: np.float32


class Bins(NamedTuple):
    """A ``SpinGrid`` as the kernels use it."""

    radius_sq: np.float32
    height: np.float32
    scale: np.float32
    rows: np.int32
    cols: np.int32


class Templates(NamedTuple):
    """Grids and templates as arrays.

    ``numbers`` (G, 3) float32: radius_sq, height and bins_per_m of each grid; ``sizes`` (G, 2)
    int32: rows and cols; ``grid_of`` (T,) int64; ``weights`` (T, widest k) float64, of sum 1;
    ``values`` (T, widest k) float64: weights times unit values; ``least`` (T,) float32: least
    correlation of a hit.
    """

    numbers: NDArray[np.float32]
    sizes: NDArray[np.int32]
    grid_of: NDArray[np.int64]
    weights: NDArray[np.float64]
    values: NDArray[np.float64]
    least: NDArray[np.float32]


class Scratch(NamedTuple):
    """Memory of one thread, used again for every origin."""

    numbers: NDArray[np.uint16]
    counts: NDArray[np.uint32]
    image: NDArray[np.uint32]
    sums: NDArray[np.float64]


def make_scratch(sizes: NDArray[np.int32]) -> Scratch:
    """Allocate one thread's memory for grids of these (rows, cols)."""
    k = int(sizes.prod(axis=1).max())
    return Scratch(
        np.empty(BUFFER, np.uint16),
        np.empty((COPIES, k + LANES), np.uint32),
        np.empty(k, np.uint32),
        np.empty((3, k)),
    )


@inner
def grid_bins(templates, g):
    """Return grid ``g`` of the table as ``Bins``."""
    numbers, sizes = templates.numbers, templates.sizes
    return Bins(numbers[g, 0], numbers[g, 1], numbers[g, 2], sizes[g, 0], sizes[g, 1])


@inner
def bounding_box(origins, members):
    """Return the least and greatest x, y, z of some origins: (6,) float32."""
    box = np.empty(6, np.float32)
    for axis in range(3):
        low = high = origins[members[0], axis]
        for o in members:
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
    reach = radius * (1.0 + SLACK) + 1e-9 * cell_m * max(nx, ny)
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
        half = np.sqrt(max(reach * reach - gap * gap, 0.0)) + SLACK * reach
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
        numbers[j] = np.uint16(bucket if dx * dx + dy * dy < radius_sq else BUCKETS)


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
    first = np.empty(BUCKETS + 2, np.int64)
    n = 0
    if origins < ORDER_FROM:  # one bucket holds all
        for r in range(found):
            begin, end = runs[0, r], runs[1, r]
            for j in range(begin, end):
                u[n], v[n], w[n] = x[j], y[j], z[j]
                n += 1
        fill(first, total)
        first[0] = 0
        return Nearby(u, v, w, first[: BUCKETS + 1], box[5], np.float32(0))
    per_m = np.float32((BUCKETS - 1) / (np.float64(box[5]) - np.float64(box[4]) + height))
    numbers = np.empty(total + PAD, np.uint16)
    for r in range(found):
        begin, end = runs[0, r], runs[1, r]
        whole = (end - begin + LANES - 1) // LANES * LANES
        _number_buckets(
            x[begin : begin + whole], y[begin : begin + whole], z[begin : begin + whole],
            box, radius_sq, per_m, numbers[n : n + whole],
        )  # fmt: skip
        n += end - begin
    fill(first, 0)
    for j in range(total):
        first[np.uint64(numbers[j]) + np.uint64(1)] += 1
    for bucket in range(1, BUCKETS + 2):
        first[bucket] += first[bucket - 1]
    place = first.copy()
    n = 0
    for r in range(found):
        for j in range(runs[0, r], runs[1, r]):
            to = np.uint64(place[numbers[n]])
            place[numbers[n]] += 1
            u[to], v[to], w[to] = x[j], y[j], z[j]
            n += 1
    return Nearby(u, v, w, first[: BUCKETS + 1], box[5], per_m)


@inner
def depth_window(near, low, high, height):
    """Find the gathered points that hold all an origin between ``low`` and ``high`` can see."""
    if near.per_m == 0:  # not ordered
        return near.first[0], near.first[BUCKETS]
    last = np.float32(BUCKETS - 1)
    begin = np.int64(min((near.top - high) * near.per_m, last))
    end = np.int64(min((near.top - low + height) * near.per_m, last)) + 2  # one for rounding
    return near.first[begin], near.first[min(end, BUCKETS)]


@inner
def _bin_points(x, y, z, ox, oy, oz, bins, numbers):
    """Find each point's bin number, beyond the bins for those outside the image (vectorised)."""
    radius_sq, height, scale, cols = bins.radius_sq, bins.height, bins.scale, bins.cols
    outside = bins.rows * cols
    for j in range(len(x)):
        dx = x[j] - ox
        dy = y[j] - oy
        depth = oz - z[j]
        a2 = dx * dx + dy * dy
        number = np.int32(depth * scale) * cols + np.int32(np.sqrt(a2) * scale)
        inside = (a2 < radius_sq) & (depth > np.float32(0)) & (depth < height)
        numbers[j] = np.uint16(number if inside else outside + np.int32(j & (LANES - 1)))


@inner
def _count_numbers(numbers, counts):
    """Add bin numbers to the interleaved histograms ``counts`` (COPIES, bins)."""
    h0, h1, h2, h3 = counts[0], counts[1], counts[2], counts[3]
    whole = len(numbers) // 4 * 4
    for j in range(0, whole, 4):
        h0[numbers[j]] += np.uint32(1)
        h1[numbers[j + 1]] += np.uint32(1)
        h2[numbers[j + 2]] += np.uint32(1)
        h3[numbers[j + 3]] += np.uint32(1)
    for j in range(whole, len(numbers)):
        h0[numbers[j]] += np.uint32(1)


@inner
def count_origin(near, ox, oy, oz, bins, scratch):
    """Count one origin's spin image into ``scratch.image``; return the points visited."""
    begin, end = depth_window(near, oz, oz, bins.height)
    k = np.int64(bins.rows) * bins.cols
    image, counts = scratch.image, scratch.counts
    if begin >= end:
        fill(image[:k], 0)
        return 0
    for copy in range(COPIES):
        fill(counts[copy, : k + LANES], 0)
    for at in range(begin, end, BUFFER):
        n = min(end - at, BUFFER)
        whole = (n + LANES - 1) // LANES * LANES
        _bin_points(
            near.x[at : at + whole], near.y[at : at + whole], near.z[at : at + whole],
            ox, oy, oz, bins, scratch.numbers[:whole],
        )  # fmt: skip
        _count_numbers(scratch.numbers[:n], counts)
    h0, h1, h2, h3 = counts[0], counts[1], counts[2], counts[3]
    for i in range(k):
        image[i] = h0[i] + h1[i] + h2[i] + h3[i]
    return end - begin


@inner
def _pearson(image, weights, values, sums):
    """Correlation of counts with a template, see ``spin_image.correlation``.

    ``weights`` (k,) sum to 1; ``values`` (k,) are weights times the template's unit values. The
    sums are taken pairwise, in an order that no machine's vectors change; ``sums`` (3, k) float64
    is scratch.
    """
    k = len(weights)
    mean, square, product = sums[0], sums[1], sums[2]
    for i in range(k):
        c = np.float64(image[i])
        wc = weights[i] * c
        mean[i] = wc
        square[i] = wc * c
        product[i] = values[i] * c
    while k > 1:
        half = (k + 1) >> 1
        for i in range(k - half):
            mean[i] += mean[i + half]
        for i in range(k - half):
            square[i] += square[i + half]
        for i in range(k - half):
            product[i] += product[i + half]
        k = half
    variance = square[0] - mean[0] * mean[0]
    if variance <= FLAT_VARIANCE * square[0]:
        return np.float32(0)
    return np.float32(min(max(product[0] / np.sqrt(variance), -1.0), 1.0))


@inner
def correlate_origin(near, ox, oy, oz, templates, wanted, scratch, out):
    """Correlate one origin with the wanted templates into ``out`` (T,); return the visits."""
    visits = 0
    for g in range(len(templates.sizes)):
        seen = np.int64(-1)
        for t in range(len(wanted)):
            if wanted[t] and templates.grid_of[t] == g:
                bins = grid_bins(templates, g)
                k = np.int64(bins.rows) * bins.cols
                if seen < 0:
                    seen = count_origin(near, ox, oy, oz, bins, scratch)
                    visits += seen
                out[t] = np.float32(0)
                if seen > 0:
                    weights, values = templates.weights[t, :k], templates.values[t, :k]
                    out[t] = _pearson(scratch.image, weights, values, scratch.sums)
    return visits
