"""The files of a scene with planted objects: cloud, labels and config."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.config import RunConfig, load_config
from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.scenes.planting import Plant
from spinpipe.pipeline.scenes.write_ply import cloud_rows, ply_header
from spinpipe.schemas import CLOUD, DETECTIONS, UPRIGHT
from spinpipe.schemas.records import Detection
from spinpipe.stages.geometry.frames import heading_deg, to_world

COLOUR = (230, 60, 200)
"""Of planted points, so that a person can tell them from the scene's own."""


@dataclass(frozen=True)
class Planted:
    """A planted object with the name of its model."""

    model: str
    plant: Plant


def write_planted(
    folder: RunFolder, config: RunConfig, planted: Sequence[Planted], target: Path
) -> RunConfig:
    """Write scene.ply, truth.csv and config.toml of the planted scene; give its config.

    The scene is in the run's world frame: metres, z up. What the run had found in it is in the
    truth too, to be ignored. The config is the run's but for its scene.
    """
    target.mkdir(parents=True, exist_ok=True)
    _write_scene(target / "scene.ply", folder, [p.plant for p in planted])
    known = [d for d in RunReader(folder)(DETECTIONS) if d.fate in ("accepted", "ambiguous")]
    _write_text(target / "truth.csv", _truth_text(planted, known))
    document = tomllib.loads(config.to_toml())
    document["run"]["name"] = f"{config.run.name}-plant"
    document["ingest"] |= {"scene": "scene.ply", "scale": 1.0}
    document["ground"]["up"] = [0.0, 0.0, 1.0]
    _write_text(target / "config.toml", tomli_w.dumps(document))
    return load_config(target / "config.toml")


def _write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"))


def _truth_text(planted: Sequence[Planted], known: Sequence[Detection]) -> str:
    buffer = StringIO()
    table = csv.writer(buffer, lineterminator="\n")
    table.writerow(["model", "x", "y", "z", "heading_deg", "ignore", "visibility"])
    for p in planted:
        T = p.plant.T_world_object
        numbers = [f"{v:.4f}" for v in (*T[:3, 3], heading_deg(T))]
        table.writerow([p.model, *numbers, 0, f"{p.plant.visibility:.3f}"])
    for d in known:
        table.writerow([d.model, *(f"{v:.4f}" for v in (*d.position_world, d.heading_deg)), 1, ""])
    return buffer.getvalue()


def _write_scene(path: Path, folder: RunFolder, plants: Sequence[Plant]) -> None:
    """The cloud without what the planted objects hide, then the objects, as a binary PLY."""

    def write(partial: Path) -> None:
        count = sum(len(rows) for rows in _scene_rows(folder, plants))
        vertex = cloud_rows(np.empty((0, 3)), np.empty((0, 3), np.uint8)).dtype
        with partial.open("wb") as stream:
            stream.write(ply_header(vertex, count, comment="planted by spinpipe"))
            for rows in _scene_rows(folder, plants):
                stream.write(rows.tobytes())

    write_atomically(path, write)


def _scene_rows(folder: RunFolder, plants: Sequence[Plant]) -> Iterator[NDArray[np.void]]:
    read = RunReader(folder)
    upright = read(UPRIGHT)[0]
    for tile in read(CLOUD):
        xyz = to_world(upright, tile.xyz)
        hidden = np.zeros(len(xyz), bool)
        for plant in plants:
            hidden |= plant.hides(xyz)
        yield cloud_rows(xyz[~hidden], tile.rgb[~hidden])
    for plant in plants:
        yield cloud_rows(plant.points, np.array(COLOUR, np.uint8))
