"""Compiled work on points says what its plain numpy twin says, on ordinary and on nasty points."""

from __future__ import annotations

import numpy as np
import pytest

from spinpipe.schemas.arrays import F64
from spinpipe.stages.geometry.hashing import GOLDEN, mix
from spinpipe.stages.ingest.point_blocks import (
    MORTON_BITS,
    descend,
    finite_rows,
    hashed,
    morton_keys,
    to_local,
)


@pytest.fixture(params=["some", "one", "none"])
def points(request: pytest.FixtureRequest) -> F64:
    """(N, 3): some of them equal, at 0 and -0, in large numbers."""
    rng = np.random.default_rng(0)
    xyz = rng.normal(0, 1, (300, 3)) * [1.0, 1e3, 1e6]
    xyz[10:20], xyz[20], xyz[21] = xyz[0], 0.0, -0.0
    return {"some": xyz, "one": xyz[:1], "none": xyz[:0]}[request.param]


def test_only_what_float32_can_hold_is_kept(points: F64) -> None:
    xyz = np.concatenate([points, [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf], [1e39, 0, 0]]])
    with np.errstate(over="ignore"):
        expected = np.isfinite(xyz.astype(np.float32)).all(axis=1)
    count, good, low, high = finite_rows(xyz)
    assert count == len(points)
    np.testing.assert_array_equal(good, expected)
    np.testing.assert_array_equal(low, xyz[expected].min(axis=0, initial=np.inf))
    np.testing.assert_array_equal(high, xyz[expected].max(axis=0, initial=-np.inf))


def test_hashes_are_those_of_the_coordinates(points: F64) -> None:
    state = np.zeros(len(points), np.uint64)
    for axis in range(3):
        state = mix(state + (points[:, axis] + 0.0).view(np.uint64) + GOLDEN)
    np.testing.assert_array_equal(hashed(points, GOLDEN), state)


def test_local_coordinates_have_no_negative_zero(points: F64) -> None:
    origin, scale = np.array([0.0, -7.5, 1e5]), np.array([1.0, -0.3, 2.0])
    local = np.empty(points.shape, np.float32)
    to_local(points, origin, scale, local)
    expected = ((points - origin) * scale).astype(np.float32) + np.float32(0)
    np.testing.assert_array_equal(local.view(np.uint32), expected.view(np.uint32))


def test_points_fall_into_the_leaf_that_the_cuts_say(points: F64) -> None:
    xyz, rng, depth = points.astype(np.float32), np.random.default_rng(1), 4
    axes, cuts = rng.integers(0, 3, 15), rng.normal(0, 1, 15).astype(np.float32)
    leaf = np.empty(len(xyz), np.int64)
    descend(xyz, axes, cuts, depth, leaf)

    def leaf_of(point: F64, node: int = 0) -> int:
        if node >= 15:
            return node - 15
        beyond = point[axes[node]] >= cuts[node]
        return leaf_of(point, 2 * node + (2 if beyond else 1))

    assert leaf.tolist() == [leaf_of(point) for point in xyz]


def test_morton_keys_take_the_bits_of_all_axes_in_turn(points: F64) -> None:
    xyz = np.abs(points).astype(np.float32)
    low = xyz.min(axis=0, initial=0)
    cells_per_m = (2**MORTON_BITS - 1) / 1e7
    cells = ((xyz - low).astype(np.float64) * cells_per_m).astype(np.uint64)
    expected = np.zeros(len(xyz), np.uint64)
    for bit in range(MORTON_BITS):
        for axis in range(3):
            one = (cells[:, axis] >> np.uint64(bit)) & np.uint64(1)
            expected |= one << np.uint64(3 * bit + axis)
    np.testing.assert_array_equal(morton_keys(xyz, low, cells_per_m), expected)
