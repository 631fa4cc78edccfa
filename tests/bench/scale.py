"""How well ``ingest.scale = "search"`` finds the unit of a scene whose unit is known.

    uv run python tests/bench/scale.py SCENE.ply MODEL.ply --units 0.3 0.7 1.9

Scene and model are clouds in metres; the scene is written in each of the units and searched.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from plyfile import PlyData

from spinpipe.pipeline import api
from spinpipe.stages.stage import StageError


def main() -> None:
    """Print a line a unit."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("model", type=Path)
    parser.add_argument("--units", type=float, nargs="+", required=True, help="metres")
    options = parser.parse_args()
    vertex = PlyData.read(str(options.scene))["vertex"]
    xyz = np.stack([vertex[axis] for axis in "xyz"], axis=1).astype(np.float64)
    for unit in options.units:
        began = time.perf_counter()
        try:
            found = api.find(xyz / unit, {"object": options.model}, ingest={"scale": "search"})
            said = found.notes["ingest"][0]
        except StageError as error:
            said = str(error)
        print(f"{unit:g} m: {said} ({time.perf_counter() - began:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
