"""``spinpipe plant``: recall without labels, from objects planted into the user's own scene."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from scipy.spatial import KDTree

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.commands import execute, run_folder
from spinpipe.pipeline.config import load_config
from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.drawing.recording import RecordMode
from spinpipe.pipeline.evaluation.evaluate import evaluate_run
from spinpipe.pipeline.evaluation.picture import write_picture
from spinpipe.pipeline.evaluation.plant_report import plant_document, plant_table
from spinpipe.pipeline.outputs import locked
from spinpipe.pipeline.results.complete import open_complete
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.scenes.free_places import Footprint, Place, blocked_cells, free_places
from spinpipe.pipeline.scenes.ground_grid import GroundGrid, ground_grid, ground_spread
from spinpipe.pipeline.scenes.planted_scene import Planted, write_planted
from spinpipe.pipeline.scenes.planting import look_around, plant, visible_surface
from spinpipe.schemas import CLOUD, MODELS, SAMPLING, TILES, UPRIGHT
from spinpipe.schemas.arrays import F32
from spinpipe.schemas.records import ObjectModel
from spinpipe.stages.geometry.skin import shown
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.stage import StageError

FILES = ("scene.ply", "truth.csv", "config.toml", "plant.json", "plant.png")
CELLS_ACROSS = 8
"""Cells of the ground across the narrow side of the smallest model."""
MOST_CELLS = 4000
"""Along each side of the ground's grid."""
SPACING_NEIGHBOURS = 8
"""Of a point, that tell how far apart points are."""


def plant_command(
    path: Path, count: int, seed: int, picture: bool, rerun: RecordMode, force: bool
) -> None:
    """``spinpipe plant``."""
    if path.is_dir():
        folder, config = open_complete(path)
    else:
        config = load_config(path)
        folder = run_folder(config, None)
        execute(config, folder, None, None, rerun="off", force=force)
    console = Console()
    planted = plant_objects(folder, count, np.random.default_rng(seed))
    console.print(f"planted {len(planted)} of {count} objects", highlight=False)
    target = folder.path / "plant"
    with locked(target, force=force) as outputs:
        outputs.claim(*(target / name for name in FILES))
        config = write_planted(folder, config, planted, target)
        console.print("looking for them ...", highlight=False)
        execute(config, RunFolder(target / "run"), None, None, rerun, quiet=True)
        radius_m = match_radius_m(list(RunReader(folder)(MODELS)))
        evaluation = evaluate_run(
            RunFolder(target / "run"), target / "truth.csv", radius_m=radius_m, rule="any"
        )
        document = json.dumps(plant_document(evaluation, planted), indent=1, allow_nan=False) + "\n"
        write_atomically(target / "plant.json", lambda file: file.write_text(document, "utf-8"))
        console.print(plant_table(evaluation, planted), highlight=False)
        if picture:
            write_picture(evaluation, RunReader(RunFolder(target / "run")), target / "plant.png")
    console.print(f"results in {target}/", highlight=False, soft_wrap=True)


def plant_objects(folder: RunFolder, count: int, rng: np.random.Generator) -> list[Planted]:
    """Plant the run's models in turn, at random free places of its scene.

    Raises
    ------
    StageError
        If there is no room for a single one.
    """
    read = RunReader(folder)
    cloud = WorldCloud.of(read(CLOUD), read(TILES)[0], read(UPRIGHT)[0])
    models, sampling = list(read(MODELS)), read(SAMPLING)[0]
    turns = [_stretched(models[i % len(models)], rng) for i in range(count)]
    footprints = [_footprint(model) for model in turns]
    tallest = max(f.height_m for f in footprints)
    grid = _ground(cloud, footprints)
    lowest_height = min(f.height_m for f in footprints)
    clear_m = ground_spread(
        grid, _pieces(cloud), 0.05 * lowest_height, 0.2 * lowest_height, share=0.99
    )
    blocked = blocked_cells(grid, _pieces(cloud), clear_m, tallest)
    places = free_places(grid, blocked, footprints, 2 * grid.cell_m, rng)
    planted: list[Planted] = []
    for model, place in zip(turns, places, strict=False):
        nearby = _around(cloud, place, grid.cell_m)
        try:
            around = look_around(nearby, grid, place, clear_m)
        except ValueError:  # hardly any ground: nothing to take density and noise from
            continue
        surface = visible_surface(shown(model, sampling), around.density, rng)
        planted.append(Planted(model.name, plant(surface, place, around, nearby, grid, rng)))
    if not planted:
        raise StageError(
            f"{folder.path}: no free ground for '{models[0].name}' in this scene; "
            "plant a smaller model or use a larger scene"
        )
    return planted


def match_radius_m(models: Sequence[ObjectModel]) -> float:
    """Farthest match: half the diagonal of the smallest model, at most 1.5 m."""
    sizes = [m.size[:2] for m in models]
    return min(1.5, min(float(np.hypot(*size)) / 2 for size in sizes))


def _stretched(model: ObjectModel, rng: np.random.Generator) -> ObjectModel:
    """A model that may stretch stands for objects of many sizes: one of them."""
    if not model.stretch:
        return model
    factors = (1 + model.stretch * rng.uniform(-1, 1, 3)).astype(np.float32)
    return replace(model, points=model.points * factors, vertices=model.vertices * factors)


def _footprint(model: ObjectModel) -> Footprint:
    surface = model.vertices if len(model.vertices) else model.points
    length, width, height = np.ptp(surface, axis=0).tolist()
    return Footprint(length, width, height)


def _ground(cloud: WorldCloud, footprints: Sequence[Footprint]) -> GroundGrid:
    """Local ground of the whole scene, strays far outside left out."""
    sample = np.concatenate([xyz[:: max(1, len(xyz) // 2000)] for xyz in _pieces(cloud)])
    low, high = np.percentile(sample[:, :2], [0.1, 99.9], axis=0)
    narrow = min(min(f.length_m, f.width_m) for f in footprints)
    longest = max(max(f.length_m, f.width_m) for f in footprints)
    largest = int(np.argmax(cloud.counts))
    spacing_m = _spacing_m(cloud.points(largest))
    finest_m = float((high - low).max()) / MOST_CELLS
    cell_m = max(narrow / CELLS_ACROSS, 2 * spacing_m, finest_m)
    return ground_grid(
        _pieces(cloud),
        low,
        high,
        cell_m=cell_m,
        window_m=4 * longest,
        step_m=min(0.25 * min(f.height_m for f in footprints), cell_m),
    )


def _spacing_m(xyz: F32) -> float:
    """Typical distance of neighbours, seen from above."""
    tree = KDTree(xyz[:, :2])
    some = xyz[:: max(1, len(xyz) // 2000), :2]
    reach = tree.query(some, k=min(SPACING_NEIGHBOURS + 1, len(xyz)))[0][:, -1]
    return float(np.median(reach)) * float(np.sqrt(np.pi / SPACING_NEIGHBOURS))


def _pieces(cloud: WorldCloud) -> Iterator[F32]:
    return (cloud.points(tile) for tile in range(len(cloud)))


def _around(cloud: WorldCloud, place: Place, margin_m: float) -> F32:
    reach = float(np.hypot(place.footprint.length_m, place.footprint.width_m)) / 2 + 2 * margin_m
    low = np.array([place.x - reach, place.y - reach, -np.inf])
    return cloud.inside(low, np.array([place.x + reach, place.y + reach, np.inf]))
