"""The example that ships: the paper's artificial scene, its models and its ground truth."""

from __future__ import annotations

import csv
from io import StringIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.stages.artificial import SEED, ArtificialScene, make_scene

SCENE_POINTS = 250_000
"""[Bovenkamp 2010, section 3.1]."""

DEMO_CONFIG = """\
# The paper's artificial scene [Bovenkamp 2010, section 3.1] with the paper's numbers: four cars of
# model 1 are found, four of model 2 are not.
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
min_correlation = 0.6

[cluster]
method = "delaunay"
max_edge_m = 2.5
"""


def write_example(
    folder: Path, noise_m: float = 0.0, points: int = SCENE_POINTS
) -> ArtificialScene:
    """Write scene.ply, model_1.ply, model_2.ply and truth.csv: the same bytes every time."""
    folder.mkdir(parents=True, exist_ok=True)
    scene = make_scene(points, noise_m, rng=np.random.default_rng(SEED))
    _write(folder / "scene.ply", scene.xyz, scene.rgb)
    for name, model in scene.models.items():
        _write(folder / f"{name}.ply", model.cloud)
    buffer = StringIO()
    table = csv.writer(buffer, lineterminator="\n")
    table.writerow(["model", "x", "y", "z", "heading_deg"])
    for row in scene.truth:
        numbers = (row.x, row.y, row.z, row.heading_deg)
        table.writerow([row.model, *(f"{v:.4f}" for v in numbers)])
    text = buffer.getvalue()
    write_atomically(folder / "truth.csv", lambda path: path.write_text(text, encoding="utf-8"))
    return scene


def _write(path: Path, xyz: NDArray[np.float64], rgb: NDArray[np.uint8] | None = None) -> None:
    colours = ("red", "green", "blue") if rgb is not None else ()
    rows = np.empty(len(xyz), [*((a, "<f4") for a in "xyz"), *((c, "u1") for c in colours)])
    rows["x"], rows["y"], rows["z"] = xyz.T
    if rgb is not None:
        rows["red"], rows["green"], rows["blue"] = rgb.T
    data = PlyData([PlyElement.describe(rows, "vertex")], byte_order="<")
    write_atomically(path, lambda partial: data.write(str(partial)))
