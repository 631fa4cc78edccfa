"""Non-maximum suppression: peaks, their claims, and independence of the order of hits."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spinpipe.stages.cluster.suppression import suppress


def scene(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 12, (count, 3)).astype(np.float32) / 2
    return points, rng.integers(0, 5, count).astype(np.float32) / 5


@given(seed=st.integers(0, 10**6), count=st.integers(0, 50), radius_m=st.floats(0.1, 4))
def test_peaks_are_apart_and_claim_what_is_near(seed: int, count: int, radius_m: float) -> None:
    points, correlation = scene(seed, count)
    peaks, members = suppress(points, correlation, radius_m)
    assert members.shape == (count,)
    assert set(members.tolist()) == set(range(len(peaks)))
    xy = points[:, :2].astype(np.float64)
    for number, peak in enumerate(peaks):
        assert members[peak] == number
        others = np.delete(peaks, number)
        assert (np.linalg.norm(xy[others] - xy[peak], axis=1) > radius_m).all()
    reach = np.linalg.norm(xy - xy[peaks[members]], axis=1) if count else np.empty(0)
    assert (reach <= radius_m * (1 + 1e-9)).all()
    assert (correlation <= correlation[peaks[members]]).all()
    assert (np.diff(correlation[peaks]) <= 0).all()


@given(seed=st.integers(0, 10**6), count=st.integers(1, 50))
def test_the_order_of_hits_does_not_matter(seed: int, count: int) -> None:
    points, correlation = scene(seed, count)
    order = np.random.default_rng(seed).permutation(count)
    peaks, members = suppress(points, correlation, 1.0)
    shuffled, shuffled_members = suppress(points[order], correlation[order], 1.0)
    np.testing.assert_array_equal(points[peaks], points[order][shuffled])
    np.testing.assert_array_equal(members[order], shuffled_members)


def test_height_does_not_separate_hits() -> None:
    points = np.array([[0, 0, 0], [0, 0, 9]], np.float32)
    peaks, members = suppress(points, np.array([0.7, 0.9], np.float32), 0.5)
    assert peaks.tolist() == [1]
    assert members.tolist() == [0, 0]
