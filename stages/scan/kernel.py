"""Compiled loops over blocks of neighbouring origins, see ``correlate``.

Only these outermost kernels are cached on disk, see ``compiled``.
"""
# pyright: basic

from __future__ import annotations

import numpy as np

from spinpipe.stages.compiled import kept
from spinpipe.stages.scan.count import correlate_counted, count_origin
from spinpipe.stages.scan.gather import bounding_box, gather
from spinpipe.stages.scan.pruning import search_group


@kept("scan")
def count_blocks(index, origins, start, grid, scratch, images):
    """Spin images into ``images`` (M, k), which is all 0."""
    for block in range(len(start) - 1):
        begin, end = start[block], start[block + 1]
        box = bounding_box(origins[begin:end])
        near = gather(index, box, grid.radius_sq, grid.height, end - begin)
        for o in range(begin, end):
            x, y, z = origins[o, 0], origins[o, 1], origins[o, 2]
            if count_origin(near, x, y, z, grid, scratch) > 0:
                for i in range(len(scratch.image)):
                    images[o, i] = scratch.image[i]


@kept("scan")
def scan_blocks(index, origins, start, templates, scratch, found, work):
    """Correlations with all templates into ``found`` (T, M).

    ``work`` (3,) counts visits, tests and origins scanned.
    """
    grid, wanted = templates.grid, np.ones(len(found), np.bool_)
    result = np.empty(len(found), np.float32)
    for block in range(len(start) - 1):
        begin, end = start[block], start[block + 1]
        box = bounding_box(origins[begin:end])
        near = gather(index, box, grid.radius_sq, grid.height, end - begin)
        work[2] += end - begin
        for o in range(begin, end):
            x, y, z = origins[o, 0], origins[o, 1], origins[o, 2]
            # written out: through ``correlate_origin`` all takes a tenth longer
            visits = count_origin(near, x, y, z, grid, scratch)
            work[0] += visits
            if visits > 0:
                correlate_counted(templates, wanted, scratch, result)
            for t in range(len(found)):
                found[t, o] = result[t] if visits > 0 else np.float32(0)


@kept("scan")
def prune_blocks(index, origins, start, templates, least, scratch, tests, found, work):
    """Correlations of at least ``least`` into ``found`` (T, M), the rest left as it is.

    ``tests`` is memory for the tests of groups, ``work`` as of ``scan_blocks``.
    """
    grid = templates.grid
    for block in range(len(start) - 1):
        begin, end = start[block], start[block + 1]
        box = bounding_box(origins[begin:end])
        near = gather(index, box, grid.radius_sq, grid.height, end - begin)
        members = np.arange(begin, end)
        search_group(near, origins, members, templates, least, scratch, tests, found, work)
