"""A model cut from each of several labelled instances in turn: does it matter which one is cut?

    uv run python tests/bench/cuts.py SCENE TRUTH.csv --size 18.6,2.9,3.6 --at 2 5 9 12 15 20

A user cuts out whichever instance comes first, with its bumps, gaps and a missing side. Everything
but the model is left at its default. ``own`` is the score at the place that the model was cut from.
Labels have x, y, perhaps z, and axis_deg or outward_deg.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from spinpipe.pipeline import api

SPINPIPE = (sys.executable, "-c", "from spinpipe.pipeline.entry import main; main()")


def spinpipe(*arguments: object) -> None:
    """Run a command as a user would; what it complains of ends the benchmark."""
    done = subprocess.run([*SPINPIPE, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)


def config(path: Path, scene: Path, model: str) -> Path:
    """Write a config of one model."""
    path.write_text(f'[ingest]\nscene = "{scene}"\n\n[[model]]\nname = "thing"\n{model}\n')
    return path


def main() -> None:
    """Print a line an instance."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--size", required=True, help="length,width,height of the box, metres")
    parser.add_argument("--at", type=int, nargs="+", required=True, help="rows of the labels")
    parser.add_argument("--z", help="of the bases, where instances stand on several levels")
    parser.add_argument("--radius", type=float, default=1.2, help="farthest match, metres")
    options = parser.parse_args()
    scene, truth = options.scene.resolve(), options.truth.resolve()
    with truth.open() as stream:
        labels = list(csv.DictReader(stream))
    print(f"{'cut':>4} {'labels':>7} {'found':>6} {'false':>6} {'own':>5} {'seconds':>8}")
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        first = config(folder / "first.toml", scene, 'shape = "saloon"')
        common = ("--rerun", "off", "-o")
        spinpipe("run", first, "--until", "ground", *common, folder / "first")
        for row in options.at:
            label, model = labels[row], folder / f"{row}.ply"
            at = ",".join(filter(None, (label["x"], label["y"], label.get("z") or options.z)))
            heading = label.get("axis_deg") or label["outward_deg"]
            spinpipe(
                *("model", "cut", folder / "first", "--at", at, "--size", options.size),
                *("--heading", heading, "--name", "thing", "--out", model),
            )
            began, run = time.perf_counter(), folder / f"run {row}"
            text = f'path = "{model}"\nvisible_from = "above"'
            spinpipe("run", config(folder / f"{row}.toml", scene, text), *common, run)
            seconds = time.perf_counter() - began
            spinpipe("eval", run, "--truth", truth, "--any-model", "--radius", options.radius)
            report = json.loads((run / "eval.json").read_text())
            found = report["accepted"]
            counts = (report["labels"]["counted"], found["found"], found["false"])
            place = float(label["x"]), float(label["y"])
            near = (
                d
                for d in api.open(run).detections
                if math.dist(d.position_scene[:2], place) < options.radius
            )
            own = max((d.score for d in near), default=0.0)
            said = f"{' '.join(f'{n:6}' for n in counts)} {own:5.2f} {seconds:8.1f}"
            print(f"{row:4} {said}", flush=True)


if __name__ == "__main__":
    main()
