"""Thinning for display: the same points at every call, evenly over all tiles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from spinpipe.schemas.arrays import F32, I64, U8

_MOST_PIECES = 256


class Piece(NamedTuple):
    """The points shown of one tile, or of some consecutive ones: one entity."""

    number: int
    last_tile: int
    xyz: F32
    """(M, 3)."""
    rgb: U8
    """(M, 3)."""


def piece_count(tiles: int) -> int:
    """Entities that so many tiles are shown by: a viewer suffers from thousands of them."""
    return -(-tiles // _tiles_a_piece(tiles))


def preview(clouds: Iterable[tuple[F32, U8]], counts: Sequence[int], limit: int) -> Iterator[Piece]:
    """Thin coloured tiles to ``min(limit, total)`` points, one tile in memory at a time.

    Parameters
    ----------
    clouds : coordinates (N, 3) and colours (N, 3) of each tile
    counts : points of each tile
    limit : most points over all tiles, at least 1

    Yields
    ------
    Piece
        In the order of the tiles.
    """
    together = _tiles_a_piece(len(counts))
    kept: list[tuple[F32, U8]] = []
    rows_of_tiles = preview_rows(counts, limit)
    for number, ((xyz, rgb), rows) in enumerate(zip(clouds, rows_of_tiles, strict=True)):
        kept.append((xyz[rows], rgb[rows]))
        if len(kept) == together or number == len(counts) - 1:
            points, colors = (np.concatenate(part) for part in zip(*kept, strict=True))
            yield Piece(number // together, number, points, colors)
            kept = []


def preview_rows(counts: Sequence[int], limit: int) -> Iterator[I64]:
    """Rows to show of each tile.

    Row ``g`` of the concatenated tiles is shown when it is ``floor(j * total / shown)`` for a
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
    total = sum(counts)
    shown = min(limit, total)
    start = 0
    for count in counts:
        first = _first_at_or_after(start, shown, total)
        last = _first_at_or_after(start + count, shown, total)
        yield np.arange(first, last, dtype=np.int64) * total // max(shown, 1) - start
        start += count


def _first_at_or_after(row: int, shown: int, total: int) -> int:
    """Smallest ``j`` with ``floor(j * total / shown) >= row``."""
    return -(-row * shown // total) if total else 0


def _tiles_a_piece(tiles: int) -> int:
    return max(1, -(-tiles // _MOST_PIECES))
