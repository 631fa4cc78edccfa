"""One point a voxel, whatever the order and the tiles; which voxels touch."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spinpipe.stages.scan.voxels import Voxels

SIDES = st.sampled_from([0.3, 0.5, 1.0])


def points(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.integers(-20, 20, (count, 3)) / 8).astype(np.float32)


def voxel_of(xyz: np.ndarray, side_m: float) -> np.ndarray:
    return np.floor(xyz.astype(np.float64) / side_m).astype(np.int64)


@given(seed=st.integers(0, 10**6), count=st.integers(0, 80), side_m=SIDES)
def test_every_voxel_has_one_point(seed: int, count: int, side_m: float) -> None:
    xyz = points(seed, count)
    rows = Voxels.of(xyz, side_m).representatives
    assert (np.diff(rows) > 0).all()
    voxels = {tuple(v) for v in voxel_of(xyz, side_m).tolist()}
    chosen = [tuple(v) for v in voxel_of(xyz[rows], side_m).tolist()]
    assert len(chosen) == len(set(chosen))
    assert set(chosen) == voxels


@given(seed=st.integers(0, 10**6), count=st.integers(1, 80), side_m=SIDES)
def test_order_leaves_no_trace(seed: int, count: int, side_m: float) -> None:
    xyz = np.unique(points(seed, count), axis=0)
    shuffled = np.random.default_rng(seed).permutation(xyz)
    whole = xyz[Voxels.of(xyz, side_m).representatives]
    other = shuffled[Voxels.of(shuffled, side_m).represents()]
    np.testing.assert_array_equal(np.unique(other, axis=0), np.unique(whole, axis=0))


@given(
    seed=st.integers(0, 10**6),
    count=st.integers(1, 60),
    side_m=SIDES,
    far=st.sampled_from([0.0, 1e3, 3e6, -2e7]),
)
def test_touching_voxels_are_those_one_step_away(
    seed: int, count: int, side_m: float, far: float
) -> None:
    """Outliers so far away that the keys would not fit 64 bits change nothing."""
    rng = np.random.default_rng(seed)
    xyz = points(seed, count)
    xyz[rng.random((count, 3)) < 0.1] += np.float32(far)
    rows = np.flatnonzero(rng.random(count) < 0.2)
    voxel = voxel_of(xyz, side_m)
    step = np.abs(voxel[:, None] - voxel[rows]).max(axis=2, initial=0)
    expected = (step <= 1).any(axis=1) if len(rows) else np.zeros(count, bool)
    np.testing.assert_array_equal(Voxels.of(xyz, side_m).touching(rows), expected)


def test_the_point_nearest_to_the_centre_is_chosen() -> None:
    xyz = np.array([[0.1, 0.1, 0.1], [0.6, 0.5, 0.5], [0.9, 0.9, 0.9]], np.float32)
    assert Voxels.of(xyz, 1.0).representatives.tolist() == [1]


def test_of_equal_points_the_first_remains() -> None:
    xyz = np.zeros((4, 3), np.float32) + np.float32(0.5)
    assert Voxels.of(xyz, 1.0).representatives.tolist() == [0]


def test_of_equal_distances_the_least_coordinates_remain() -> None:
    xyz = np.array([[0.75, 0.5, 0.5], [0.25, 0.5, 0.5], [0.5, 0.25, 0.5]], np.float32)
    assert Voxels.of(xyz, 1.0).representatives.tolist() == [1]
