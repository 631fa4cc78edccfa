"""Compiled loops over blocks of neighbouring origins, see ``correlate``.

Only these outermost kernels are cached on disk, see ``compiled``.
"""
# pyright: basic

from __future__ import annotations

import numpy as np
from numba import njit

from spinpipe.stages.compiled import inner, sources
from spinpipe.stages.scan.count import (
    correlate_counted,
    count_origin,
    grid_bins,
)
from spinpipe.stages.scan.gather import bounding_box, gather
from spinpipe.stages.scan.pruning import search_group


@inner
def _reach(templates):
    """Return the largest squared radius and the largest height of all grids."""
    radius_sq = height = np.float32(0)
    for g in range(len(templates.sizes)):
        radius_sq = max(radius_sq, templates.numbers[g, 0])
        height = max(height, templates.numbers[g, 1])
    return radius_sq, height


def _kernels(sources: str):
    """Define the outermost kernels; numba keys its cache by the values they enclose."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def count_blocks(index, origins, start, templates, scratch, images):
        """Spin images for the table's first grid into ``images`` (M, k), which is all 0."""
        _ = sources
        bins = grid_bins(templates, 0)
        for block in range(len(start) - 1):
            begin, end = start[block], start[block + 1]
            box = bounding_box(origins[begin:end])
            near = gather(index, box, bins.radius_sq, bins.height, end - begin)
            for o in range(begin, end):
                x, y, z = origins[o, 0], origins[o, 1], origins[o, 2]
                if count_origin(near, x, y, z, bins, scratch) > 0:
                    for i in range(len(scratch.image)):
                        images[o, i] = scratch.image[i]

    @njit(cache=True, nogil=True, error_model="numpy")
    def scan_blocks(index, origins, start, templates, scratch, found, work):
        """Correlations with all templates into ``found`` (T, M).

        ``work`` (3,) counts visits, tests and origins scanned.
        """
        _ = sources
        radius_sq, height = _reach(templates)
        wanted = np.ones(len(templates.least), np.bool_)
        result = np.empty(len(wanted), np.float32)
        for block in range(len(start) - 1):
            begin, end = start[block], start[block + 1]
            box = bounding_box(origins[begin:end])
            near = gather(index, box, radius_sq, height, end - begin)
            work[2] += end - begin
            for g in range(len(templates.sizes)):
                bins = grid_bins(templates, g)
                for o in range(begin, end):
                    x, y, z = origins[o, 0], origins[o, 1], origins[o, 2]
                    visits = count_origin(near, x, y, z, bins, scratch)
                    work[0] += visits
                    if visits > 0:
                        correlate_counted(templates, g, wanted, scratch, result)
                    for t in range(templates.first[g], templates.first[g + 1]):
                        found[t, o] = result[t] if visits > 0 else np.float32(0)

    @njit(cache=True, nogil=True, error_model="numpy")
    def prune_blocks(index, origins, start, templates, scratch, tests, found, work):
        """Correlations of hits into ``found`` (T, M), the rest left as it is.

        ``tests`` is memory for the tests of groups, ``work`` as of ``scan_blocks``.
        """
        _ = sources
        radius_sq, height = _reach(templates)
        for block in range(len(start) - 1):
            begin, end = start[block], start[block + 1]
            box = bounding_box(origins[begin:end])
            near = gather(index, box, radius_sq, height, end - begin)
            members = np.arange(begin, end)
            search_group(near, origins, members, templates, scratch, tests, found, work)

    return count_blocks, scan_blocks, prune_blocks


count_blocks, scan_blocks, prune_blocks = _kernels(sources("scan"))
