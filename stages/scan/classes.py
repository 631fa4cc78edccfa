"""Points around a group of origins, counted by the bins that they may fall into; compiled.

A point at distance ``a`` and depth ``b`` from the group's middle lies, seen from any origin of the
group, within ``a -+ d`` and ``b -+ e``, in bins. Its class is the pair of first and last bin that
it may reach along each axis. With ``j = floor(v - d)`` and ``k = floor(v + d)``, ``k - j`` is ``D``
or ``D + 1``, ``D = floor(2 d)``, so that the sum ``j + k`` names the pair.
"""
# pyright: basic

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spinpipe.schemas.arrays import F32, I32, U32
from spinpipe.stages.compiled import inner
from spinpipe.stages.scan.count import BUFFER, idle_lanes
from spinpipe.stages.scan.gather import LANES, fill

MAX_SHIFT_BINS = 3.0
"""Groups are tested from this reach ``d`` on; wider ones are split first."""
MAX_LIFT_BINS = 1.0
"""The same for ``e``."""
SHIFT_MARGIN_BINS = 1e-3
"""Widening of ``d`` and ``e``, far above the rounding of float32 bin coordinates."""
COPIES = 2
"""Interleaved tallies, see ``count.COPIES``."""


class Classes(NamedTuple):
    """How the points around a group are numbered.

    Row and column coordinates are shifted by whole bins to stay positive. A class number is
    ``(row class - base) * 2 * half + (col class odd) * half + col class // 2``.
    """

    d: np.float32
    e: np.float32
    shift_col: np.int32
    shift_row: np.int32
    base: np.int32
    rows: np.int32
    half: np.int32


class TestScratch(NamedTuple):
    """Memory of one thread for tests: of the widest group."""

    numbers: I32
    lanes: I32
    tallies: U32
    middle: F32
    value: F32
    largest: F32
    line: F32
    total: F32


@inner
def widened(extent, bins):
    """Add the margin to a reach in bins, such that twice it is no whole number."""
    reach = extent + SHIFT_MARGIN_BINS + 1e-6 * bins
    part = 2 * reach - np.floor(2 * reach)
    if part < 0.01:
        reach += 0.005
    elif part > 0.99:
        reach += 0.01
    return reach


@inner
def lay_out(rows, cols, d, e):
    """Lay out the classes of a group with reaches ``d`` and ``e``, in bins."""
    D, E = np.int64(2 * d), np.int64(2 * e)
    shift_col, shift_row = D // 2 + 2, E + 2
    half = (cols + D + shift_col + 3 + LANES - 1) // LANES * LANES
    return Classes(
        d=np.float32(d),
        e=np.float32(e),
        shift_col=np.int32(shift_col),
        shift_row=np.int32(shift_row),
        base=np.int32(2 * shift_row - E - 2),
        rows=np.int32(2 * rows + 2 * E + 6),
        half=np.int32(half),
    )


def make_test_scratch(rows: int, cols: int) -> TestScratch:
    """Allocate one thread's memory for tests with a grid of this shape."""
    widest = lay_out.py_func(rows, cols, MAX_SHIFT_BINS + 1, MAX_LIFT_BINS + 1)
    half = int(widest.half)
    return TestScratch(
        numbers=np.empty(BUFFER, np.int32),
        lanes=idle_lanes(),
        tallies=np.empty((COPIES, 2 * int(widest.rows) * half + LANES), np.uint32),
        middle=np.empty((rows, half), np.float32),
        value=np.empty((rows, 2 * half), np.float32),
        largest=np.empty((2, rows, half), np.float32),
        line=np.empty(half, np.float32),
        total=np.empty(half, np.float32),
    )


@inner
def _number_classes(x, y, z, mx, my, mz, reach_sq, scale, bottom, classes, lanes, numbers):
    """Class number of each point, past the last class for those out of reach (vectorised)."""
    d, e, base, half = classes.d, classes.e, classes.base, classes.half
    shift_col, shift_row = np.float32(classes.shift_col), np.float32(classes.shift_row)
    outside = classes.rows * (half + half)
    for i in range(len(x)):
        dx = x[i] - mx
        dy = y[i] - my
        a2 = dx * dx + dy * dy
        v = np.sqrt(a2) * scale + shift_col
        u = (mz - z[i]) * scale + shift_row
        col = np.int32(v + d) + np.int32(v - d)
        row = np.int32(u + e) + np.int32(u - e) - base
        number = row * (half + half) + (col & np.int32(1)) * half + (col >> np.int32(1))
        inside = (a2 < reach_sq) & (u + e >= shift_row) & (u - e < bottom)
        numbers[i] = number if inside else outside + lanes[i]


@inner
def count_classes(near, begin, end, mx, my, mz, reach_sq, grid, classes, scratch):
    """Count the classes of ``near[begin:end]`` into ``scratch.tallies[0]``; return their sum."""
    size = np.int64(classes.rows) * 2 * classes.half
    bottom = np.float32(grid.height * grid.bins_per_m + classes.shift_row + SHIFT_MARGIN_BINS)
    for copy in range(COPIES):
        fill(scratch.tallies[copy, : size + LANES], 0)
    t0, t1 = scratch.tallies[0], scratch.tallies[1]
    for at in range(begin, end, BUFFER):
        n = min(end - at, BUFFER)
        whole = (n + LANES - 1) // LANES * LANES
        numbers = scratch.numbers[:whole]
        _number_classes(
            near.x[at : at + whole], near.y[at : at + whole], near.z[at : at + whole],
            mx, my, mz, reach_sq, grid.bins_per_m, bottom, classes, scratch.lanes, numbers,
        )  # fmt: skip
        for j in range(0, n // 2 * 2, 2):
            t0[np.uint32(numbers[j])] += np.uint32(1)
            t1[np.uint32(numbers[j + 1])] += np.uint32(1)
        if n % 2:
            t0[np.uint32(numbers[n - 1])] += np.uint32(1)
    total = np.int64(0)
    for i in range(size):
        t0[i] += t1[i]
        total += t0[i]
    return total


@inner
def mean_image(classes, rows, cols, scratch):
    """Spread the classes evenly over their bins: about the mean of the group's images."""
    half, shift = np.int64(classes.half), np.int64(classes.shift_col)
    middle, line = scratch.middle, scratch.line
    for r in range(rows):
        fill(middle[r, :cols], np.float32(0))
    share = np.float32(0.5)
    for row in range(classes.rows):
        pair = row + classes.base
        bin_row = (pair >> 1) - classes.shift_row
        if bin_row < -1 or bin_row >= rows:
            continue
        at = np.int64(row) * 2 * half
        even, odd = scratch.tallies[0, at : at + half], scratch.tallies[0, at + half :]
        before = scratch.tallies[0, at + half + shift - 1 :]
        even, odd = even[shift:], odd[shift:]
        for c in range(cols):
            line[c] = np.float32(even[c]) + share * (np.float32(odd[c]) + np.float32(before[c]))
        part = share if pair & 1 else np.float32(1)
        if bin_row >= 0:
            for c in range(cols):
                middle[bin_row, c] += part * line[c]
        if pair & 1 and bin_row + 1 < rows:
            for c in range(cols):
                middle[bin_row + 1, c] += part * line[c]
