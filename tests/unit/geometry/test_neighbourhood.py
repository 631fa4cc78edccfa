"""The cloud in the world, found through the boxes of its tiles."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from spinpipe.schemas.records import CloudTile, TileIndex, Upright
from spinpipe.stages.geometry.frames import to_world
from spinpipe.stages.geometry.world_cloud import WorldCloud


def upright(seed: int) -> Upright:
    x, y, z, w = Rotation.random(rng=np.random.default_rng(seed)).as_quat().tolist()
    return Upright((x, y, z, w), (0.0, 0.0, 1.5))


def tiled(xyz: np.ndarray, tiles: int, turned: Upright) -> WorldCloud:
    pieces = np.array_split(xyz[np.argsort(xyz[:, 0])], tiles)
    index = TileIndex(
        np.stack([p.min(axis=0) for p in pieces]),
        np.stack([p.max(axis=0) for p in pieces]),
        np.array([len(p) for p in pieces]),
    )
    white = [CloudTile(p, np.full((len(p), 3), 255, np.uint8)) for p in pieces]
    return WorldCloud.of(white, index, turned)


def cloud(seed: int, count: int = 300) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 5, (count, 3)).astype(np.float32)


def as_set(points: np.ndarray) -> set[tuple[float, ...]]:
    return {tuple(p) for p in points.tolist()}


@given(seed=st.integers(0, 10**6), tiles=st.integers(1, 9))
def test_a_box_holds_the_same_points_whatever_the_tiles_are(seed: int, tiles: int) -> None:
    xyz, turned = cloud(seed), upright(seed)
    low = np.random.default_rng(seed).normal(0, 4, 3)
    high = low + 4.0
    world = to_world(turned, xyz)
    expected = world[np.all((world >= low) & (world <= high), axis=1)]
    assert as_set(tiled(xyz, tiles, turned).inside(low, high)) == as_set(expected)


@given(seed=st.integers(0, 10**6), tile=st.integers(0, 5))
def test_surroundings_hold_every_neighbour_of_every_point(seed: int, tile: int) -> None:
    xyz, turned = cloud(seed), upright(seed)
    world = tiled(xyz, 6, turned)
    points, own = world.around(tile, radius_m=1.5, below_m=1.0)
    np.testing.assert_array_equal(points[own], world.points(tile))
    around = as_set(points)
    everything = to_world(turned, xyz)
    for point in world.points(tile):
        apart = everything - point
        near = np.hypot(apart[:, 0], apart[:, 1]) <= 1.5
        near &= (apart[:, 2] <= 0) & (apart[:, 2] >= -1.0)
        assert as_set(everything[near]) <= around


def test_points_of_a_tile_are_those_of_its_message() -> None:
    turned = upright(0)
    world = tiled(cloud(1), 4, turned)
    assert len(world) == 4
    assert world.counts == (75, 75, 75, 75)
    np.testing.assert_array_equal(world.points(2), to_world(turned, world.tiles[2].xyz))


def test_an_empty_box_is_empty() -> None:
    world = tiled(cloud(2), 4, upright(2))
    found = world.inside(np.full(3, 1e6), np.full(3, 2e6))
    assert found.shape == (0, 3)
    assert found.dtype == np.float32


@pytest.mark.parametrize("far", [1e2, 1e4])
def test_rounding_far_from_the_origin_loses_no_point(far: float) -> None:
    xyz = cloud(3) + np.float32(far)
    world = tiled(xyz, 5, upright(3))
    assert len(world.inside(np.full(3, -1e9), np.full(3, 1e9))) == len(xyz)
