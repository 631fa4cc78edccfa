"""The example that ships: the paper's artificial scene, its models and its ground truth."""

from __future__ import annotations

import csv
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.scenes.artificial import SEED, ArtificialScene, make_scene
from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply

EXAMPLE_FILES = ("scene.ply", "model_1.ply", "model_2.ply", "truth.csv")
SCENE_POINTS = 250_000
"""[Bovenkamp 2010, section 3.1]."""

DEMO_CONFIG = """\
# The paper's artificial scene [Bovenkamp 2010, section 3.1], searched with its spin image at every
# point. The threshold is lower than the paper's 0.6, so that the cars of model 2 become candidates
# too: verification tells them apart.
[run]
name = "demo"

[ingest]
scene = "scene.ply"

[[model]]
name = "model_1"
path = "model_1.ply"

[scan]
radius_m = 2.5
height_m = 1.0
bin_m = 0.1
min_correlation = 0.4
heights = "any"
origins = "all"
"""


def write_example(
    folder: Path, noise_m: float = 0.0, points: int = SCENE_POINTS
) -> ArtificialScene:
    """Make the scene and write it: the same bytes every time."""
    scene = make_scene(points, noise_m, rng=np.random.default_rng(SEED))
    write_scene(folder, scene)
    return scene


def write_scene(folder: Path, scene: ArtificialScene) -> None:
    """Write scene.ply, model_1.ply, model_2.ply and truth.csv."""
    folder.mkdir(parents=True, exist_ok=True)
    clouds = {"scene": cloud_rows(scene.xyz, scene.rgb)}
    clouds |= {name: cloud_rows(model.cloud) for name, model in scene.models.items()}
    for name, rows in clouds.items():
        write_atomically(folder / f"{name}.ply", partial(write_ply, vertices=rows))
    buffer = StringIO()
    table = csv.writer(buffer, lineterminator="\n")
    table.writerow(["model", "x", "y", "z", "heading_deg"])
    for row in scene.truth:
        numbers = (row.x, row.y, row.z, row.heading_deg)
        table.writerow([row.model, *(f"{v:.4f}" for v in numbers)])
    text = buffer.getvalue()
    write_atomically(folder / "truth.csv", lambda path: path.write_text(text, encoding="utf-8"))
