"""Thinning for display: the same points at every call, evenly over all tiles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray


def preview_rows(counts: Iterable[int], limit: int) -> Iterator[NDArray[np.int64]]:
    """Rows to show of each tile so that all tiles together show ``min(limit, total)`` points.

    Row ``g`` of the concatenated tiles is shown when it is ``floor(j * total / limit)`` for a
    whole number ``j``: every k-th point on average, whatever the tiles' sizes. Tiles are sorted in
    space, so the thinned cloud is as evenly spread as the full one.

    Parameters
    ----------
    counts : points of each tile
    limit : most points over all tiles, at least 1

    Yields
    ------
    (M,) int64, ascending rows of one tile
    """
    sizes = [int(count) for count in counts]
    total = sum(sizes)
    shown = min(limit, total)
    start = 0
    for size in sizes:
        first = _first_at_or_after(start, shown, total)
        last = _first_at_or_after(start + size, shown, total)
        yield np.arange(first, last, dtype=np.int64) * total // max(shown, 1) - start
        start += size


def _first_at_or_after(row: int, shown: int, total: int) -> int:
    """Smallest ``j`` with ``floor(j * total / shown) >= row``."""
    return -(-row * shown // total) if total else 0
