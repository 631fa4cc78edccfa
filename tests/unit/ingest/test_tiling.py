"""Tiling: every point once, in tiles of bounded size, whatever the order of the points."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spinpipe.stages.ingest.scatter_file import ScatterFile
from spinpipe.stages.ingest.tiling import POINT, HashSample, kd_split, tiles_of

SHAPES = ("random", "grid", "same point", "line", "far outliers", "half at one place")


def cloud(shape: str, count: int, seed: int = 0) -> NDArray[Any]:
    rng = np.random.default_rng(seed)
    points = np.empty(count, POINT)
    xyz = rng.normal(0, (50, 20, 2), (count, 3))
    if shape == "grid":
        xyz = np.rint(xyz / 10)
    elif shape == "same point":
        xyz[:] = 1.5
    elif shape == "line":
        xyz[:, 1:] = 0
    elif shape == "far outliers":
        xyz[: count // 50] *= 1e6
    elif shape == "half at one place":
        xyz[: count // 2] = xyz.min(axis=0)
    points["xyz"] = xyz
    points["rgb"] = rng.integers(0, 256, (count, 3))
    return rng.permutation(points)


def as_set(points: NDArray[Any]) -> list[bytes]:
    return sorted(point.tobytes() for point in points)


def tiles(points: NDArray[Any], most: int, folder: Path, chunk: int = 1000) -> list[NDArray[Any]]:
    sample = HashSample(512)
    for start in range(0, len(points), chunk):
        sample.add(points["xyz"][start : start + chunk].astype(np.float64))
    split = kd_split(sample.points.astype(np.float32), len(points), most)
    with ScatterFile(folder, split.leaves) as scatter:
        for start in range(0, len(points), chunk):
            piece = points[start : start + chunk]
            scatter.append(piece, split.leaf_of(piece["xyz"]))
        return [t for leaf in range(split.leaves) for t in tiles_of(scatter.read(leaf), most)]


@given(
    shape=st.sampled_from(SHAPES),
    count=st.integers(1, 3000),
    most=st.integers(50, 3000),
    chunks=st.tuples(st.integers(50, 4000), st.integers(50, 4000)),
    seed=st.integers(0, 100),
)
@settings(deadline=None)
def test_every_point_once_and_the_same_tiles_for_any_order(
    tmp_path_factory: pytest.TempPathFactory,
    shape: str,
    count: int,
    most: int,
    chunks: tuple[int, int],
    seed: int,
) -> None:
    folder = tmp_path_factory.mktemp("tiles")
    points = cloud(shape, count, seed)
    found = tiles(points, most, folder, chunks[0])
    assert all(0 < len(tile) <= most for tile in found)
    # Each place once, with the same one of its colours in any order
    assert len(np.concatenate(found)) == len(np.unique(points["xyz"], axis=0))
    assert set(as_set(np.concatenate(found))) <= set(as_set(points))

    shuffled = np.random.default_rng(seed + 1).permutation(points)
    again = tiles(shuffled, most, folder, chunks[1])
    assert [tile.tobytes() for tile in found] == [tile.tobytes() for tile in again]


@pytest.mark.parametrize("shape", ["random", "far outliers"])
def test_tiles_are_well_filled_and_compact(tmp_path: Path, shape: str) -> None:
    points = cloud(shape, 40_000)
    found = tiles(points, 1000, tmp_path)
    assert np.mean([len(tile) for tile in found]) > 400
    # Tiles hold neighbours: most are far smaller than the cloud, which is about 200 m long
    reach = [np.ptp(tile["xyz"], axis=0).max() for tile in found]
    assert np.median(reach) < 40


def test_neighbours_in_a_tile_are_near_each_other() -> None:
    (tile,) = tiles_of(cloud("random", 5000), 5000)
    steps = np.linalg.norm(np.diff(tile["xyz"], axis=0), axis=1)
    shuffled = np.random.default_rng(0).permutation(tile["xyz"])
    assert np.median(steps) < 0.25 * np.median(np.linalg.norm(np.diff(shuffled, axis=0), axis=1))


@given(
    st.lists(st.integers(1, 500), min_size=1, max_size=20),
    st.integers(1, 400),
    st.integers(0, 9),
)
@settings(deadline=None)
def test_sample_depends_on_the_points_alone(sizes: list[int], most: int, seed: int) -> None:
    xyz = np.random.default_rng(seed).normal(0, 1e6, (sum(sizes), 3))
    xyz[::5] = np.where(xyz[::5] > 0, 0.0, -0.0)
    pieces = HashSample(most)
    for piece in np.split(xyz, np.cumsum(sizes)[:-1]):
        pieces.add(piece)
    backwards = HashSample(most)
    backwards.add(np.where(xyz == 0, -xyz, xyz)[::-1])
    assert len(pieces.points) <= most

    def ordered(points: NDArray[Any]) -> NDArray[Any]:
        return points[np.lexsort(points.T)]

    np.testing.assert_array_equal(ordered(pieces.points), ordered(backwards.points))


def test_sample_is_as_large_as_asked_and_fair() -> None:
    xyz = np.random.default_rng(0).normal(0, 10, (50_000, 3))
    sample = HashSample(4000)
    sample.add(xyz)
    assert 1800 < len(sample.points) <= 4000
    np.testing.assert_allclose(sample.points.mean(axis=0), 0, atol=1)
    np.testing.assert_allclose(sample.points.std(axis=0), 10, atol=1)
