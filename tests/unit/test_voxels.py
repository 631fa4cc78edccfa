"""One point a voxel, whatever the order and the tiles."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spinpipe.stages.voxels import voxel_representatives


def points(seed: int, count: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.integers(-20, 20, (count, 3)) / 8).astype(np.float32)


@given(seed=st.integers(0, 10**6), count=st.integers(0, 80), side_m=st.sampled_from([0.3, 0.5, 1]))
def test_every_voxel_has_one_point(seed: int, count: int, side_m: float) -> None:
    xyz = points(seed, count)
    rows = voxel_representatives(xyz, xyz, side_m)
    assert (np.diff(rows) > 0).all()
    voxels = {tuple(v) for v in np.floor(xyz.astype(np.float64) / side_m).tolist()}
    chosen = [tuple(v) for v in np.floor(xyz[rows].astype(np.float64) / side_m).tolist()]
    assert len(chosen) == len(set(chosen))
    assert set(chosen) == voxels


@given(seed=st.integers(0, 10**6), count=st.integers(1, 80), side_m=st.sampled_from([0.3, 0.5, 1]))
def test_tiles_and_order_leave_no_trace(seed: int, count: int, side_m: float) -> None:
    rng = np.random.default_rng(seed)
    xyz = np.unique(points(seed, count), axis=0)
    whole = xyz[voxel_representatives(xyz, xyz, side_m)]
    shuffled = rng.permutation(xyz)
    part = rng.integers(0, 3, len(shuffled))
    pieces = [shuffled[part == i] for i in range(3)]
    chosen = [p[voxel_representatives(p, shuffled, side_m)] for p in pieces]
    np.testing.assert_array_equal(
        np.unique(np.concatenate(chosen), axis=0), np.unique(whole, axis=0)
    )


def test_the_point_nearest_to_the_centre_is_chosen() -> None:
    xyz = np.array([[0.1, 0.1, 0.1], [0.6, 0.5, 0.5], [0.9, 0.9, 0.9]], np.float32)
    assert voxel_representatives(xyz, xyz, 1.0).tolist() == [1]


def test_of_equal_points_the_first_remains() -> None:
    xyz = np.zeros((4, 3), np.float32) + np.float32(0.5)
    assert voxel_representatives(xyz, xyz, 1.0).tolist() == [0]
