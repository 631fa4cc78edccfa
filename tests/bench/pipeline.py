"""How the whole pipeline scales: seconds of every stage and peak memory, from 2M to 50M points.

    uv run python tests/bench/pipeline.py --millions 2 10 50

The scene is the paper's artificial one at 1000 points per square metre with 3 cm noise (so that
ground points see each other), laid out side by side as often as the points need. Each run is a
process of its own; memory is the operating system's peak resident size of that process.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from spinpipe.pipeline.demo import write_example
from spinpipe.pipeline.scenes.artificial import EXTENT_M, make_scene
from spinpipe.stages import STAGES

POINTS_PER_BLOCK = 2_000_000
NOISE_M = 0.03
ROW = np.dtype([*((a, "<f4") for a in "xyz"), *((c, "u1") for c in ("red", "green", "blue"))])

CONFIG = """\
[ingest]
scene = "{scene}"
[[model]]
name = "model_1"
path = "{model}"
[execution]
threads = {threads}
memory_gb = {memory_gb}
"""


def write_scene(path: Path, blocks: int) -> int:
    """Write ``blocks`` artificial scenes side by side; returns the number of cars of model 1."""
    side = math.ceil(math.sqrt(blocks))
    header = "ply\nformat binary_little_endian 1.0\n"
    header += f"element vertex {blocks * POINTS_PER_BLOCK}\n"
    header += "".join(f"property float {a}\n" for a in "xyz")
    header += "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")) + "end_header\n"
    cars = 0
    with path.open("wb") as stream:
        stream.write(header.encode())
        for block in range(blocks):
            scene = make_scene(POINTS_PER_BLOCK, NOISE_M, np.random.default_rng(block))
            rows = np.empty(len(scene.xyz), ROW)
            shift = np.array([block % side, block // side, 0]) * EXTENT_M
            rows["x"], rows["y"], rows["z"] = (scene.xyz + shift).T
            rows["red"], rows["green"], rows["blue"] = scene.rgb.T
            stream.write(rows.tobytes())
            cars += sum(row.model == "model_1" for row in scene.truth)
    return cars


def run(config: Path, folder: Path) -> tuple[float, float]:
    """Wall seconds and peak resident gigabytes of one run."""
    command = [sys.executable, "-c", "from spinpipe.pipeline.entry import main; main()"]
    command += ["run", str(config), "--output", str(folder)]
    began = time.perf_counter()
    process = subprocess.Popen(command)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"the run failed with status {status}")
    return time.perf_counter() - began, usage.ru_maxrss * 1024 / 1e9


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--millions", type=int, nargs="+", default=[2, 10])
    parser.add_argument("--threads", type=int, nargs="+", default=[2])
    parser.add_argument("--memory-gb", type=float, default=4.0)
    parser.add_argument("--folder", type=Path, help="keep the files here")
    options = parser.parse_args()
    stages = tuple(stage.name for stage in STAGES)
    columns = ("points", "threads", *stages, "whole run", "again", "us/point", "peak", "found")
    print("| " + " | ".join(columns) + " |")
    print("|" + " ---: |" * len(columns))
    with tempfile.TemporaryDirectory() as temporary:
        work = options.folder or Path(temporary)
        write_example(work)
        for millions in options.millions:
            scene = work / f"scene_{millions}M.ply"
            blocks = max(1, millions * 1_000_000 // POINTS_PER_BLOCK)
            cars = write_scene(scene, blocks)
            for threads in options.threads:
                config = work / f"{millions}M_{threads}.toml"
                config.write_text(
                    CONFIG.format(
                        scene=scene,
                        model=work / "model_1.ply",
                        threads=threads,
                        memory_gb=options.memory_gb,
                    )
                )
                folder = work / f"run_{millions}M_{threads}"
                wall_s, peak_gb = run(config, folder)
                again_s, _ = run(config, folder)  # nothing is left to do
                report = json.loads((folder / "report.json").read_text())
                seconds = {s["stage"]: s["seconds"] for s in report["stages"]}
                document = json.loads((folder / "detections.json").read_text())
                found = sum(d["fate"] == "accepted" for d in document["detections"])
                points = blocks * POINTS_PER_BLOCK
                print(
                    f"| {points:,} | {threads} | "
                    + " | ".join(f"{seconds[s]:.1f} s" for s in stages)
                    + f" | {wall_s:.1f} s | {again_s:.1f} s | {1e6 * wall_s / points:.2f} "
                    f"| {peak_gb:.2f} GB | {found} of {cars} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
