"""A part of a cloud by whole squares: any tiling, any order, about as many points as asked for."""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.records import CloudTile, TileIndex, Upright
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.ground.sampled_squares import points_of_some_squares

XYZ = np.random.default_rng(3).uniform(-50, 50, (40_000, 3)).astype(np.float32)


def part(tiles: int, points: int, seed: int = 0) -> np.ndarray:
    pieces = np.array_split(np.random.default_rng(seed).permutation(XYZ), tiles)
    index = TileIndex(
        np.stack([p.min(axis=0) for p in pieces]),
        np.stack([p.max(axis=0) for p in pieces]),
        np.array([len(p) for p in pieces]),
    )
    white = [CloudTile(p, np.full((len(p), 3), 255, np.uint8)) for p in pieces]
    cloud = WorldCloud.of(white, index, Upright((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)))
    return points_of_some_squares(cloud, 173.0, points)


def test_a_small_cloud_comes_whole() -> None:
    assert len(part(3, 40_000)) == len(XYZ)


def test_tiles_and_order_leave_no_trace() -> None:
    np.testing.assert_array_equal(part(1, 10_000), part(7, 10_000, seed=5))


def test_about_as_many_points_as_asked_for() -> None:
    assert 8_000 < len(part(4, 10_000)) < 12_000
