"""Scans of tiles: the same hits whatever the tiles are, and however hits are searched for."""

from __future__ import annotations

import numpy as np
import pytest

from spinpipe.pipeline.scenes.artificial import make_scene
from spinpipe.schemas.records import CloudTile, ObjectModel, Sampling, TileIndex, Upright
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.scan.image import SpinGrid
from spinpipe.stages.scan.model_heights import HeightBands
from spinpipe.stages.scan.templates import Templates, object_image
from spinpipe.stages.scan.tile import Origins, TileScan

GRID = SpinGrid.of(2.5, 1.0, 0.2)
LEVEL = Upright((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
SCENE = make_scene(15_000)
XYZ = SCENE.xyz.astype(np.float32)
CAR = SCENE.models["model_1"].cloud.astype(np.float32)
MODEL = ObjectModel(
    "car",
    CAR,
    np.zeros_like(CAR),
    np.empty((0, 3), np.float32),
    np.empty((0, 3), np.int32),
    np.eye(4),
    "all",
)


def cloud(tiles: int) -> WorldCloud:
    order = np.argsort(XYZ[:, 0] if tiles % 2 else XYZ[:, 1], kind="stable")
    pieces = np.array_split(XYZ[order], tiles)
    index = TileIndex(
        np.stack([p.min(axis=0) for p in pieces]),
        np.stack([p.max(axis=0) for p in pieces]),
        np.array([len(p) for p in pieces]),
    )
    grey = [CloudTile(p, np.full((len(p), 3), 128, np.uint8)) for p in pieces]
    return WorldCloud.of(grey, index, LEVEL)


def scan(
    tiles: int, origins: Origins = "all", *, pruned: bool = True, banded: bool = False
) -> set[tuple[float, ...]]:
    bands = (
        HeightBands.of([MODEL], [float(MODEL.size[2])], Sampling(0.3, 0.005)) if banded else None
    )
    task = TileScan(
        cloud=cloud(tiles),
        models=("car",),
        templates=Templates.of(GRID, [object_image(CAR, GRID)]),
        bands=bands,
        lift_m=0.1,
        origins=origins,
        min_correlation=0.5,
        voxel_m=0.3,
        pruned=pruned,
        threads=1,
    )
    found: set[tuple[float, ...]] = set()
    for tile in range(tiles):
        scores = task(tile)
        hit = scores.correlation[:, 0] >= np.float32(0.5)
        rows = np.column_stack([scores.points, scores.correlation])[hit]
        found |= {tuple(row) for row in rows.tolist()}
    return found


@pytest.mark.parametrize("banded", [False, True])
@pytest.mark.parametrize("origins", ["all", "voxel", "subset"])
def test_tiles_leave_no_trace(origins: Origins, banded: bool) -> None:
    whole = scan(1, origins, banded=banded)
    assert whole
    assert scan(5, origins, banded=banded) == whole
    assert scan(8, origins, banded=banded) == whole


def test_pruning_after_coarse_to_fine_finds_the_same() -> None:
    assert scan(3, "voxel", pruned=True) == scan(3, "voxel", pruned=False)


def test_pruning_finds_what_the_exhaustive_scan_finds() -> None:
    assert scan(3, pruned=True) == scan(3, pruned=False)


def test_coarse_to_fine_and_a_subset_find_no_more_than_all() -> None:
    everything = scan(3)
    assert scan(3, "voxel") <= everything
    assert scan(3, "subset") <= everything


def test_at_model_height_the_cars_keep_their_hits() -> None:
    banded = np.array(sorted(scan(3, banded=True)))
    assert scan(3, banded=True) <= scan(3)
    for row in SCENE.truth[:4]:
        assert np.hypot(banded[:, 0] - row.x, banded[:, 1] - row.y).min() < 1.0
