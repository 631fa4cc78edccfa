"""Four coloured points as arrays and as lines, and how a reader gives them back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from spinpipe.stages.ingest.readers.open_scene import open_scene

XYZ = np.array([[1.5, -2.25, 3.0], [1e3, 2e-3, -7.5], [0.0, 4.0, 8.125], [9.0, 9.5, 9.75]])
RGB = np.array([[255, 0, 7], [1, 2, 3], [90, 80, 70], [0, 0, 0]], np.uint8)


ROWS = "\n".join(" ".join(f"{v:.6f}" for v in row) for row in XYZ)
COLOURED = "\n".join(
    " ".join([*(f"{v:.6f}" for v in p), *map(str, c)]) for p, c in zip(XYZ, RGB, strict=True)
)
LINES = COLOURED.split("\n")
ROWS_RGB = list(zip(ROWS.split("\n"), RGB, strict=True))


def read(path: Path, chunk: int = 3) -> tuple[Any, Any]:
    source = open_scene(path)
    pieces = list(source.chunks(chunk))
    xyz = np.concatenate([np.empty((0, 3)), *(xyz for xyz, _ in pieces)])
    rgb = np.concatenate([np.empty((0, 3), np.uint8), *(rgb for _, rgb in pieces)])
    assert len(xyz) == source.points
    return xyz, rgb
