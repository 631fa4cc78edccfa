"""Compiled loops over blocks of neighbouring origins, see ``spin_kernel``."""
# pyright: basic

from __future__ import annotations

import numpy as np
from numba import njit

from spinpipe.stages.spin_count import (
    bounding_box,
    correlate_origin,
    count_origin,
    gather,
    grid_bins,
    make_scratch,
)
from spinpipe.stages.spin_pruning import make_test_scratch, search_group


@njit(cache=True, nogil=True)
def count_blocks(index, origins, order, start, templates, images):
    """Spin images for the table's first grid into ``images`` (M, k)."""
    scratch = make_scratch(templates.sizes)
    bins = grid_bins(templates, 0)
    for block in range(len(start) - 1):
        members = order[start[block] : start[block + 1]]
        box = bounding_box(origins, members)
        near = gather(index, box, bins.radius_sq, bins.height, len(members))
        for o in members:
            x, y, z = origins[o]
            count_origin(near, x, y, z, bins, scratch)
            images[o] = scratch.image


@njit(cache=True, nogil=True)
def scan_blocks(index, origins, order, start, templates, pruned, found):
    """Correlations with all templates into ``found`` (T, M); if ``pruned``, of hits only.

    Returns visits, tests and origins scanned.
    """
    scratch, tests = make_scratch(templates.sizes), make_test_scratch(templates.sizes)
    radius_sq = height = np.float32(0)
    for g in range(len(templates.sizes)):
        radius_sq = max(radius_sq, templates.numbers[g, 0])
        height = max(height, templates.numbers[g, 1])
    wanted = np.ones(len(templates.grid_of), np.bool_)
    result = np.empty(len(wanted), np.float32)
    work = np.zeros(3, np.int64)
    for block in range(len(start) - 1):
        members = order[start[block] : start[block + 1]]
        box = bounding_box(origins, members)
        near = gather(index, box, radius_sq, height, len(members))
        if pruned:
            search_group(near, origins, members.copy(), templates, scratch, tests, found, work)
            continue
        for o in members:
            x, y, z = origins[o]
            work[0] += correlate_origin(near, x, y, z, templates, wanted, scratch, result)
            work[2] += 1
            found[:, o] = result
    return work
