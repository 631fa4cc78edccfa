"""E57 files as pye57 writes them: several scans with poses, and points that are none."""

# pye57 has no types
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false, reportAttributeAccessIssue=false

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pye57
import pytest
from pye57 import libe57
from scipy.spatial.transform import Rotation

from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.stage import StageError

POSES = [
    (Rotation.from_euler("z", 90, degrees=True), np.array([100.0, 0, 2])),
    (Rotation.from_euler("xyz", [3, -4, 200], degrees=True), np.array([-5.0, 7, 1.5])),
]


def write(path: Path) -> tuple[Any, Any]:
    """Two scans of 50 points, every tenth invalid; coordinates in the file's frame, and colours."""
    rng = np.random.default_rng(0)
    places: list[Any] = []
    colours: list[Any] = []
    with pye57.E57(str(path), "w") as file:
        for turn, move in POSES:
            xyz = rng.normal(0, 5, (50, 3)).astype(np.float32).astype(np.float64)
            rgb = rng.integers(0, 200, (50, 3)).astype(np.uint8)
            columns = {f"cartesian{axis}": xyz[:, i].copy() for i, axis in enumerate("XYZ")}
            columns |= {
                f"color{c}": rgb[:, i].copy() for i, c in enumerate(("Red", "Green", "Blue"))
            }
            columns["cartesianInvalidState"] = (np.arange(50) % 10 == 0).astype(np.int8)
            columns["intensity"] = rng.uniform(size=50).astype(np.float32)
            file.write_scan_raw(columns, rotation=turn.as_quat()[[3, 0, 1, 2]], translation=move)
            places.append(np.where(np.arange(50)[:, None] % 10, turn.apply(xyz) + move, np.nan))
            colours.append(rgb)
    return np.concatenate(places), np.concatenate(colours)


def test_scans_come_in_one_frame(tmp_path: Path) -> None:
    path = tmp_path / "scans.bin"
    xyz, rgb = write(path)
    source = open_scene(path)
    assert (source.points, source.coloured) == (100, True)
    assert (source.about.kind, source.about.fields) == ("E57, 2 scans", ("intensity",))
    pieces = list(source.chunks(30))
    assert [len(piece) for piece, _ in pieces] == [30, 20, 30, 20]
    np.testing.assert_allclose(np.concatenate([p for p, _ in pieces]), xyz, atol=1e-6)
    np.testing.assert_array_equal(np.concatenate([c for _, c in pieces]), rgb)


def test_the_coordinate_system_is_read_and_the_unit_is_the_metre(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    string = libe57.StringNode
    # of all texts that pye57 writes, the coordinate system's is the empty one
    monkeypatch.setattr(
        libe57, "StringNode", lambda image, text: string(image, text or "EPSG:2225")
    )
    write(tmp_path / "a.e57")
    told = open_scene(tmp_path / "a.e57").about.coordinates
    assert (told.crs, told.metres, told.z_is_height) == ("EPSG:2225", (1.0, 1.0, 1.0), True)


def test_without_pye57_it_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.e57"
    write(path)
    monkeypatch.setitem(sys.modules, "pye57", None)
    with pytest.raises(StageError, match=r"pip install 'spinpipe\[e57\]'$"):
        open_scene(path)


def test_a_damaged_or_empty_file_says_so(tmp_path: Path) -> None:
    path = tmp_path / "a.e57"
    write(path)
    whole = path.read_bytes()
    cut = tmp_path / "cut.e57"
    for length in range(48, len(whole), 2111):
        cut.write_bytes(whole[:length])
        with pytest.raises(StageError, match=r"^[^\n]*cannot read the E57 file[^\n]*$"):
            list(open_scene(cut).chunks(10))
    assert cut.exists()
    with pye57.E57(str(path), "w"):
        pass
    with pytest.raises(StageError, match="has no scans"):
        open_scene(path)
