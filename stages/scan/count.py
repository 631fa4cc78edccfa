"""One origin's spin image and its correlations, compiled.

The points that an origin may see are a contiguous run (``gather``). It is taken in two loops,
first the bin numbers, which LLVM vectorises, then the counting. The expressions are those of the
numpy twin ``spin_image``, in float32.
"""
# pyright: basic

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spinpipe.schemas.arrays import F64, I32, I64, U32
from spinpipe.stages.compiled import inlined, inner
from spinpipe.stages.scan.gather import LANES, depth_window, fill

FLAT_VARIANCE = 1e-12
"""An image whose variance is below this part of its mean square counts as constant."""

BUFFER = 1024
"""Bin numbers held between binning and counting."""
COPIES = 4
"""Interleaved histograms: the same counter is rarely needed before its last store is done."""


class Scratch(NamedTuple):
    """Memory of one thread, used again for every origin.

    ``lanes`` (BUFFER,) is 0 .. LANES - 1 over and over: read, not computed from a loop's counter,
    whose 64 bits would halve the vectors. ``moments`` (2,): sum of the counts and of their squares.
    """

    numbers: I32
    lanes: I32
    counts: U32
    image: U32
    moments: I64
    sums: F64


def idle_lanes() -> I32:
    """Make what spreads the points that do not count over idle counters, see ``Scratch``."""
    return np.arange(BUFFER, dtype=np.int32) % np.int32(LANES)


def make_scratch(k: int) -> Scratch:
    """Allocate one thread's memory for a grid of ``k`` bins."""
    return Scratch(
        numbers=np.empty(BUFFER, np.int32),
        lanes=idle_lanes(),
        counts=np.empty((COPIES, k + LANES), np.uint32),
        image=np.empty(k, np.uint32),
        moments=np.empty(2, np.int64),
        sums=np.empty((2, k)),
    )


@inner
def _bin_points(x, y, z, ox, oy, oz, grid, lanes, numbers):
    """Find each point's bin number, beyond the bins for those outside the image (vectorised)."""
    radius_sq, height, scale, cols = grid.radius_sq, grid.height, grid.bins_per_m, grid.cols
    outside = grid.rows * cols
    for j in range(len(x)):
        dx = x[j] - ox
        dy = y[j] - oy
        depth = oz - z[j]
        a2 = dx * dx + dy * dy
        number = np.int32(depth * scale) * cols + np.int32(np.sqrt(a2) * scale)
        inside = (a2 < radius_sq) & (depth > np.float32(0)) & (depth < height)
        numbers[j] = number if inside else outside + lanes[j]


@inner
def _count_numbers(numbers, counts):
    """Add bin numbers to the interleaved histograms ``counts`` (COPIES, bins)."""
    h0, h1, h2, h3 = counts[0], counts[1], counts[2], counts[3]
    whole = len(numbers) // 4 * 4
    for j in range(0, whole, 4):
        h0[np.uint32(numbers[j])] += np.uint32(1)  # unsigned: no look for negative indices
        h1[np.uint32(numbers[j + 1])] += np.uint32(1)
        h2[np.uint32(numbers[j + 2])] += np.uint32(1)
        h3[np.uint32(numbers[j + 3])] += np.uint32(1)
    for j in range(whole, len(numbers)):
        h0[np.uint32(numbers[j])] += np.uint32(1)


@inlined
def count_origin(near, ox, oy, oz, grid, scratch):
    """Count one origin's spin image into ``scratch.image``; return the points visited.

    Where there are none the image is left as it was.
    """
    begin, end = depth_window(near, oz, oz, grid.height)
    if begin >= end:
        return 0
    k = np.int64(grid.rows) * grid.cols
    image, counts = scratch.image, scratch.counts
    for copy in range(COPIES):
        fill(counts[copy, : k + LANES], 0)
    for at in range(begin, end, BUFFER):
        n = min(end - at, BUFFER)
        whole = (n + LANES - 1) // LANES * LANES
        _bin_points(
            near.x[at : at + whole], near.y[at : at + whole], near.z[at : at + whole],
            ox, oy, oz, grid, scratch.lanes, scratch.numbers[:whole],
        )  # fmt: skip
        _count_numbers(scratch.numbers[:n], counts)
    h0, h1, h2, h3 = counts[0], counts[1], counts[2], counts[3]
    total = square = np.int64(0)
    for i in range(k):
        image[i] = h0[i] + h1[i] + h2[i] + h3[i]
        c = np.int64(np.int32(image[i]))
        total += c
        square += c * c
    scratch.moments[0], scratch.moments[1] = total, square
    return end - begin


@inner
def _pairwise_sum(terms, k):
    """Sum of ``terms[:k]``, which it uses up, in an order that no machine's vectors change."""
    while k > 1:
        half = (k + 1) >> 1
        for i in range(k - half):
            terms[i] += terms[i + half]
        k = half
    return terms[0]


@inner
def _deviation(image, weights, terms, squares):
    """Weighted standard deviation of counts; 0 if they are constant where they are weighted."""
    k = len(weights)
    for i in range(k):
        c = np.float64(image[i])
        wc = weights[i] * c
        terms[i] = wc
        squares[i] = wc * c
    mean, square = _pairwise_sum(terms, k), _pairwise_sum(squares, k)
    variance = square - mean * mean
    return np.sqrt(variance) if variance > FLAT_VARIANCE * square else 0.0


@inner
def _even_deviation(moments, k):
    """The same if all bins weigh alike."""
    mean, square = np.float64(moments[0]) / k, np.float64(moments[1]) / k
    variance = square - mean * mean
    return np.sqrt(variance) if variance > FLAT_VARIANCE * square else 0.0


@inner
def _product(image, parts):
    """Sum of counts times parts: integers, so the same in any order (vectorised)."""
    total = np.int64(0)
    for i in range(len(parts)):
        total += np.int64(np.int32(image[i])) * np.int64(parts[i])
    return np.float64(total)


@inner
def correlate_counted(templates, wanted, scratch, out):
    """Correlate the image just counted with the wanted templates into ``out`` (T,).

    See ``image.correlation``; templates of equal weights share the image's deviation.
    """
    deviation = -1.0
    for t in range(len(wanted)):
        if not templates.alike[t]:
            deviation = -1.0
        if wanted[t]:
            if deviation < 0:
                if templates.even[t]:
                    deviation = _even_deviation(scratch.moments, len(scratch.image))
                else:
                    weights = templates.weights[t]
                    deviation = _deviation(scratch.image, weights, scratch.sums[0], scratch.sums[1])
            out[t] = np.float32(0)
            if deviation > 0:
                product = templates.unit[t] * _product(scratch.image, templates.parts[t])
                out[t] = np.float32(min(max(product / deviation, -1.0), 1.0))


@inner
def correlate_origin(near, ox, oy, oz, templates, wanted, scratch, out):
    """Correlate one origin with the wanted templates into ``out`` (T,); return the visits."""
    visits = count_origin(near, ox, oy, oz, templates.grid, scratch)
    if visits > 0:
        correlate_counted(templates, wanted, scratch, out)
    else:
        fill(out, np.float32(0))
    return visits
