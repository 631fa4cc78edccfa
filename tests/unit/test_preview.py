"""Thinning for display keeps an exact number of points, evenly over all tiles."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spinpipe.pipeline.preview import preview_rows


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
