"""Thinning for display keeps an exact number of points, evenly over all tiles."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spinpipe.pipeline.drawing.preview import piece_count, preview, preview_rows


@given(
    st.lists(st.integers(0, 400), max_size=8),
    st.integers(1, 1500),
)
def test_preview_is_exact_and_even(counts: list[int], limit: int) -> None:
    rows = list(preview_rows(counts, limit))
    starts = np.cumsum([0, *counts])[:-1]
    shown = np.concatenate(
        [r + start for r, start in zip(rows, starts, strict=True)] or [np.zeros(0)]
    )
    assert len(shown) == min(limit, sum(counts))
    assert all(((r >= 0) & (r < count)).all() for r, count in zip(rows, counts, strict=True))
    if len(shown) > 1:
        gaps = np.diff(shown)
        assert gaps.min() >= 1
        assert gaps.max() - gaps.min() <= 1


@given(st.integers(0, 1500), st.integers(1, 2000))
def test_many_tiles_become_few_pieces(tiles: int, limit: int) -> None:
    clouds = [(np.full((2, 3), i, np.float32), np.zeros((2, 3), np.uint8)) for i in range(tiles)]
    pieces = list(preview(clouds, [2] * tiles, limit))
    assert [piece.number for piece in pieces] == list(range(piece_count(tiles)))
    assert len(pieces) == (tiles if tiles <= 256 else min(256, len(pieces)))
    shown = np.concatenate([np.zeros((0, 3)), *(piece.xyz for piece in pieces)])[:, 0]
    assert len(shown) == min(limit, 2 * tiles)
    assert (np.diff(shown) >= 0).all()
    assert not pieces or pieces[-1].last_tile == tiles - 1
