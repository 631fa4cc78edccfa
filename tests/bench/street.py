"""What coarse to fine scanning leaves of the detections on a dense street: none may be lost.

    uv run python tests/bench/street.py
    uv run python tests/bench/street.py --derived

The street of ``scan_scenes.py`` (eight cars between facades, trees and bushes, 1000 points per
square metre, 2 cm noise) goes through the pipeline with the spin images of ``scan.py`` and every
point as an origin, with proven pruning and coarse to fine.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scan_scenes import DENSITY, GRID, street

from spinpipe.pipeline.commands import execute
from spinpipe.pipeline.config import load_config
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.scenes.artificial_cars import SALOON, car_mesh
from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply

CONFIG = """\
[ingest]
scene = '{scene}'
[ground]
up = [0.0, 0.0, 1.0]
[scan]
heights = "any"
{sizes}
[[model]]
name = "saloon"
path = '{model}'
"""
METHODS = (
    ("all origins", ["scan.origins=all"]),
    ("pruned", ["scan.origins=all", "scan.search=pruned"]),
    ("coarse to fine", ["scan.origins=voxel"]),
)
NEAR_M = 0.5


def main() -> None:
    """Run the street with each method and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--density", type=float, default=DENSITY)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument(
        "--derived", action="store_true", help="the spin image that follows from the model"
    )
    options = parser.parse_args()
    cloud, cars = street(options.density, 0.02)
    places = np.array(cars)
    print("| method | points | scan | hits | candidates | accepted | of the cars |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        mesh = car_mesh(SALOON)
        write_ply(folder / "scene.ply", cloud_rows(cloud))
        write_ply(folder / "model.ply", cloud_rows(mesh.vertices), mesh.faces.astype(np.int32))
        config = folder / "config.toml"
        files = {"scene": folder / "scene.ply", "model": folder / "model.ply"}
        sizes = f"radius_m = {GRID.radius_m}\nheight_m = {GRID.height_m}\nbin_m = {GRID.bin_m}"
        config.write_text(CONFIG.format(**files, sizes="" if options.derived else sizes))
        for method, settings in METHODS:
            run = RunFolder(folder / "run")
            settings = [*settings, f"execution.threads={options.threads}"]
            execute(load_config(config, settings), run, None, None, "off", quiet=True)
            report = json.loads(run.report.read_text())
            found = json.loads((run.path / "detections.json").read_text())["detections"]
            accepted = [d for d in found if d["fate"] == "accepted"]
            xy = np.array([d["position_scene"][:2] for d in accepted]).reshape(-1, 2)
            near = np.linalg.norm(xy[:, None] - places, axis=2) < NEAR_M
            scan = next(s for s in report["stages"] if s["stage"] == "scan")
            print(
                f"| {method} | {len(cloud):,} | {scan['seconds']:.1f} s | {_hits(scan)} | "
                f"{len(found)} | {len(accepted)} | {near.any(axis=0).sum()} of {len(cars)} |",
                flush=True,
            )


def _hits(scan: dict[str, Any]) -> str:
    """Number of hits, from the stage's notes."""
    return next(note.split()[0] for note in scan["notes"] if " hits of " in note)


if __name__ == "__main__":
    main()
