"""Exact pruning of the spin scan: proof that no origin of a group can be a hit.

Let ``c`` be the counts at an origin, ``t`` the template with weighted mean 0 and variance 1, ``w``
the weights (sum 1), ``q`` the least correlation of a hit. A hit has ``<t, c> >= q std(c)`` where
``<a, b> = sum w a b``. For any image ``s`` with mean 0 and variance 1, Cauchy and Schwarz give
``std(c) >= <s, c>``; so a hit has ``<t - q s, c> >= 0``, a sum over points of the value
``f = w (t - q s)`` of their bins.

For a group of neighbouring origins each point's bin is known up to the group's extent: a point at
distance ``a`` and depth ``b`` from the group's middle lies, seen from any of the origins, within
``a -+ d`` and ``b -+ e``. Taking for every point the largest ``f`` over those bins (0 if it may
lie outside the image) bounds the sum for all origins at once; a bound below 0 proves that none of
them is a hit. Any ``s`` is right; the best is the group's own mean image, brought to mean 0 and
variance 1: the better the images of a group agree, the tighter the bound.
"""
# pyright: basic

from __future__ import annotations

import numpy as np

from spinpipe.stages.compiled import inner
from spinpipe.stages.scan.classes import (
    MAX_LIFT_BINS,
    MAX_SHIFT_BINS,
    SHIFT_MARGIN_BINS,
    count_classes,
    lay_out,
    mean_image,
    widened,
)
from spinpipe.stages.scan.count import correlate_origin
from spinpipe.stages.scan.gather import depth_window, fill

LIFT_WEIGHT = 6.0
"""How much sooner a group is split by height than by width."""
MIN_GROUP = 4
"""Smaller groups are scanned origin by origin."""
TEST_COST = 4000
"""What a test costs beside its visits, in visits."""
ROUNDING = 1e-5
"""Part of the sum of magnitudes that its rounding stays below."""
LOWERED = 1e-6
"""Lowering of the least correlation, above the rounding of a correlation to float32."""
_NEVER = np.float32(-3e38)
STACK = 160
"""Groups waiting at once: halving float32 extents and counts ends before that depth."""


@inner
def _bin_values(grid, weights, values, least, shift, scratch):
    """Fill ``f``, shifted by ``shift`` columns; return its sum over the mean image and its size."""
    rows, cols = np.int64(grid.rows), np.int64(grid.cols)
    middle = scratch.middle
    mean = square = product = 0.0
    for r in range(rows):
        for c in range(cols):
            m, w = np.float64(middle[r, c]), weights[r * cols + c]
            mean += w * m
            square += w * m * m
            product += values[r * cols + c] * m
    deviation = np.sqrt(max(square - mean * mean, 0.0))
    factor = least / deviation if deviation > 1e-4 * np.sqrt(square) else 0.0
    largest = np.float32(0)
    for r in range(rows):
        fill(scratch.value[r, :shift], _NEVER)
        fill(scratch.value[r, shift:], np.float32(0))
        line = scratch.value[r, shift:]
        for c in range(cols):
            i = r * cols + c
            line[c] = np.float32(values[i] - weights[i] * factor * (middle[r, c] - mean))
            largest = max(largest, abs(line[c]))
    # The last row and column may reach beyond the image.
    if grid.height * grid.bins_per_m < rows - SHIFT_MARGIN_BINS:
        for c in range(cols):
            scratch.value[rows - 1, shift + c] = max(
                scratch.value[rows - 1, shift + c], np.float32(0)
            )
    if np.sqrt(grid.radius_sq) * grid.bins_per_m < cols - SHIFT_MARGIN_BINS:
        for r in range(rows):
            scratch.value[r, shift + cols - 1] = max(
                scratch.value[r, shift + cols - 1], np.float32(0)
            )
    return product - least * deviation, np.float64(largest)


@inner
def _upper_bound(classes, rows, scratch):
    """Sum over all points of the largest ``f`` that each may get."""
    half = np.int64(classes.half)
    D, E = np.int64(2 * classes.d), np.int64(2 * classes.e)
    largest = scratch.largest
    for odd in range(2):
        # Class 2 i + odd spans the columns first .. first + span.
        span = D + ((odd - D) & 1)
        back = (span - odd) // 2
        for r in range(rows):
            line = largest[odd, r, :half]
            fill(line, _NEVER)
            for step in range(span + 1):
                skip = max(0, back - step)
                value = scratch.value[r, max(0, step - back) :]
                ahead = line[skip:]
                for i in range(len(ahead)):
                    ahead[i] = max(ahead[i], value[i])
    total, line = scratch.total[:half], scratch.line[:half]
    fill(total, np.float32(0))
    for row in range(classes.rows):
        pair = np.int64(row + classes.base)
        span = E + ((pair - E) & 1)
        first = (pair - span) // 2 - classes.shift_row
        beyond = first < 0 or first + span >= rows
        for odd in range(2):
            at = (np.int64(row) * 2 + odd) * half
            tally = scratch.tallies[0, at : at + half]
            fill(line, np.float32(0) if beyond else _NEVER)
            for r in range(max(first, 0), min(first + span, rows - 1) + 1):
                best = largest[odd, r, :half]
                for i in range(half):
                    line[i] = max(line[i], best[i])
            for i in range(half):
                total[i] += np.float32(tally[i]) * line[i]
    bound = 0.0
    for i in range(half):
        bound += total[i]
    return bound


@inner
def search_group(near, origins, members, templates, least, scratch, tests, found, work):
    """Find the hits among the origins ``members`` (reordered); others stay as they are.

    ``found`` (T, M) receives correlations of at least ``least``; ``work`` (3,) counts
    visits, tests and origins scanned.
    """
    T = len(found)
    ranges = np.empty((STACK, 2), np.int64)
    limits = np.empty(STACK)
    alive = np.empty((STACK, T), np.bool_)
    wanted = np.empty(T, np.bool_)
    result = np.empty(T, np.float32)
    box = np.empty(6, np.float32)
    ranges[0, 0], ranges[0, 1] = 0, len(members)
    limits[0] = np.inf
    fill(alive[0], True)
    depth = 1
    while depth > 0:
        depth -= 1
        begin, end = ranges[depth, 0], ranges[depth, 1]
        limit = limits[depth]
        for t in range(T):
            wanted[t] = alive[depth, t]
        for axis in range(3):
            low = high = origins[members[begin], axis]
            for i in range(begin + 1, end):
                value = origins[members[i], axis]
                low, high = min(low, value), max(high, value)
            box[2 * axis], box[2 * axis + 1] = low, high
        split = end - begin >= MIN_GROUP
        if split:
            ratio = _test(near, box, end - begin, limit, templates, least, wanted, tests, work)
            if not _any(wanted):
                continue
            # What a smaller group would need to be provable has too few origins to pay.
            split = (end - begin) * ratio * ratio >= MIN_GROUP
            if ratio < 1.0:
                limit = ratio * _extent(box)
        if not split:
            for i in range(begin, end):
                o = members[i]
                x, y, z = origins[o, 0], origins[o, 1], origins[o, 2]
                work[0] += correlate_origin(near, x, y, z, templates, wanted, scratch, result)
                work[2] += 1
                for t in range(T):
                    if wanted[t] and result[t] >= least:
                        found[t, o] = result[t]
            continue
        middle = _split(origins, members, begin, end, box)
        for part in range(2):
            ranges[depth, 0] = begin if part == 0 else middle
            ranges[depth, 1] = middle if part == 0 else end
            limits[depth] = limit
            for t in range(T):
                alive[depth, t] = wanted[t]
            depth += 1


@inner
def _any(flags):
    """Tell whether any flag is set."""
    for flag in flags:  # noqa: SIM110 (numba knows no generators here)
        if flag:
            return True
    return False


@inner
def _extent(box):
    """Size of a group as far as tests are concerned."""
    width = np.hypot(np.float64(box[1] - box[0]), np.float64(box[3] - box[2]))
    return width + LIFT_WEIGHT * np.float64(box[5] - box[4])


@inner
def _split(origins, members, begin, end, box):
    """Reorder ``members[begin:end]`` into two halves of its longest side; return the border."""
    width, depth = box[1] - box[0], box[3] - box[2]
    height = (box[5] - box[4]) * np.float32(LIFT_WEIGHT)
    axis = 0 if width >= depth and width >= height else 1 if depth >= height else 2
    level = (box[2 * axis] + box[2 * axis + 1]) * np.float32(0.5)
    i, j = begin, end - 1
    while i <= j:
        if origins[members[i], axis] < level:
            i += 1
        else:
            members[i], members[j] = members[j], members[i]
            j -= 1
    return i if begin < i < end else (begin + end) // 2


@inner
def _test(near, box, count, limit, templates, least, wanted, tests, work):
    """Clear ``wanted`` for the templates that no origin in ``box`` can hit.

    Returns the part of its size at which the group might be provable: 1 if it was not tested.
    """
    if _extent(box) > limit:
        return 1.0
    grid = templates.grid
    rows, cols = np.int64(grid.rows), np.int64(grid.cols)
    half = np.float32(0.5)
    mx, my, mz = (box[0] + box[1]) * half, (box[2] + box[3]) * half, (box[4] + box[5]) * half
    dx = np.float64(max(box[1] - mx, mx - box[0]))
    dy = np.float64(max(box[3] - my, my - box[2]))
    dz = np.float64(max(box[5] - mz, mz - box[4]))
    shift = np.sqrt(dx * dx + dy * dy)
    d, e = widened(shift * grid.bins_per_m, cols), widened(dz * grid.bins_per_m, rows)
    begin, end = depth_window(near, box[4], box[5], grid.height)
    if not (d <= MAX_SHIFT_BINS and e <= MAX_LIFT_BINS):
        return 1.0
    if count * (end - begin) < 2 * (end - begin + TEST_COST):
        return 0.0
    classes = lay_out(rows, cols, d, e)
    reach = (np.sqrt(np.float64(grid.radius_sq)) + shift) * (1 + 1e-5)
    total = count_classes(
        near, begin, end, mx, my, mz, np.float32(reach * reach), grid, classes, tests
    )
    work[0] += end - begin
    work[1] += 1
    if total == 0:
        fill(wanted, False)
        return 1.0
    mean_image(classes, rows, cols, tests)
    ratio = 1.0
    for t in range(len(wanted)):
        if wanted[t]:
            central, largest = _bin_values(
                grid, templates.weights[t], templates.values[t],
                np.float64(least) - LOWERED, classes.shift_col, tests,
            )  # fmt: skip
            upper = _upper_bound(classes, rows, tests)
            if upper < -ROUNDING * largest * total:
                wanted[t] = False
            elif central < 0:
                ratio = min(ratio, -central / (upper - central))
            else:
                ratio = min(ratio, 0.5)
    return ratio
