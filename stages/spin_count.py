"""One origin's spin image and its correlations, compiled.

The points that an origin may see are a contiguous run (``spin_gather``). It is taken in two loops,
first the bin numbers, which LLVM vectorises, then the counting. The expressions are those of the
numpy twin ``spin_image``, in float32.
"""
# pyright: basic

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.compiled import inner
from spinpipe.stages.spin_gather import LANES, depth_window, fill
from spinpipe.stages.spin_image import FLAT_VARIANCE

BUFFER = 1024
"""Bin numbers held between binning and counting."""
COPIES = 4
"""Interleaved histograms: the same counter is rarely needed before its last store is done."""


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
