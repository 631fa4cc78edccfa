"""Small inputs that users brought to bug trackers: each is understood, or its real cause named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.e2e.refusals import assert_one_line

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import DETECTIONS, MODELS, SCENE, TILES, UPRIGHT

BASE_SIZE_M = (36.07, 33.26, 5.08)
"""Of the scene that most cases are made from."""
CARS = np.array([(-8, -6), (-3, 5), (6, -7), (8, 6), (0, -12)])
"""Where they stand in it [README.md there]."""


def run(cli: Any, case: Path, output: Path) -> Any:
    return cli("run", case / "config.toml", "--until", "ground", "--rerun", "off", "-o", output)


@pytest.mark.parametrize(
    ("case", "said"),
    [
        ("base", ""),
        ("ascii-decimal-comma", ""),
        ("colmap-points3D-only", "points without cameras"),
        ("half-the-points-twice", "repeat another one"),
        ("las-header-count-zero", "its header says 0 points"),
        ("one-outlier-1e6", "left out 1 points far from all others"),
        ("one-outlier-3e04", "left out 1 points far from all others"),
        ("pdal-uppercase-ply", ""),
        ("scene-pcd", "PCD"),
        ("scene-xyz", "text, columns parted by blanks"),
        ("model-glb-y-up-default", ""),
        ("model-ply-tristrips", ""),
    ],
)
def test_the_same_scene_in_another_guise(
    cli: Any, shared_cases: Path, tmp_path: Path, case: str, said: str
) -> None:
    outcome = run(cli, shared_cases / case, tmp_path)
    assert outcome.code == 0, outcome.err
    assert said in outcome.out
    read = RunReader(RunFolder(tmp_path))
    tiles, upright = read(TILES)[0], read(UPRIGHT)[0]
    size = tiles.high.max(axis=0) - tiles.low.min(axis=0)
    np.testing.assert_allclose(size, BASE_SIZE_M, atol=0.15)
    assert read(SCENE)[0].points > 20_000
    assert upright.T_world_local[2, 2] > np.cos(np.radians(0.5))
    (model,) = read(MODELS)
    np.testing.assert_allclose(model.size, (4.53, 1.8, 1.44), atol=0.05)


@pytest.mark.parametrize("case", ["base", "noise-below-ground"])
def test_the_five_cars(cli: Any, shared_cases: Path, tmp_path: Path, case: str) -> None:
    outcome = cli("run", shared_cases / case / "config.toml", "--rerun", "off", "-o", tmp_path)
    assert outcome.code == 0, outcome.err
    found = [d for d in RunReader(RunFolder(tmp_path))(DETECTIONS) if d.fate == "accepted"]
    places = np.array([d.position_scene[:2] for d in found])
    assert len(places) == len(CARS)
    for car in CARS:
        assert np.linalg.norm(places - car, axis=1).min() < 0.3


@pytest.mark.parametrize(
    ("case", "up"),
    [
        ("real-las-up-sideways", (0, 0, 1)),
        ("real-las-upside-down", (0, 0, 1)),
        ("indoor-room-y-up", (0, 1, 0)),
    ],
)
def test_what_used_to_lie_stands(
    cli: Any, shared_cases: Path, tmp_path: Path, case: str, up: tuple[float, float, float]
) -> None:
    (path,) = (p for p in (shared_cases / case).iterdir() if p.name.startswith(("s", "append")))
    outcome = cli("inspect", "--json", path)
    assert outcome.code == 0, outcome.err
    (facts,) = json.loads(outcome.out)["files"]
    assert facts["up"]["direction"] @ np.array(up) > np.cos(np.radians(1))


@pytest.mark.parametrize("case", ["bad_faces.obj", "hang_colmapbin", "min_hang_vlrs.las"])
def test_hostile_files_are_refused_in_a_line(cli: Any, shared_cases: Path, case: str) -> None:
    outcome = cli("inspect", shared_cases / "hostile" / case)
    assert outcome.code == 1
    assert case in outcome.err
    assert outcome.err.count("\n") == 1


def test_points_all_over_a_room_hold_nothing(cli: Any, shared_cases: Path, tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(
        f"[ingest]\nscene = '{shared_cases}/hostile/min_abort.laz'\n"
        "[[model]]\nname = 'car'\nshape = 'saloon'\n"
    )
    outcome = cli("run", tmp_path / "c.toml", "--rerun", "off", "-o", tmp_path / "run")
    assert outcome.code == 0, outcome.err
    assert "accepted: none" in outcome.out
    assert (tmp_path / "run" / "report.html").is_file()


@pytest.mark.parametrize(
    ("case", "code", "said"),
    [
        ("millimetres-int-ply", 1, "try [ingest] scale = 0.001 for millimetres"),
        ("las-wgs84-degrees", 1, "x and y are degrees (WGS 84"),
        ("utm-float-ply", 1, "in steps of 0.5 m along y, as 32-bit floats have there"),
        ("windows-path", 2, "write paths with / or in single quotes"),
        ("us-feet-ply", 0, "if the scene is not in metres, set [ingest] scale"),
        ("model-obj-feet", 0, "it may be in feet: try [[model]] scale = 0.3048"),
        ("model-with-ground-sheet", 0, "because of a sheet at its base"),
        ("scene-is-a-mesh-ply", 0, "a mesh, not a cloud: 1,000,000 points drawn"),
    ],
)
def test_the_real_cause_is_named(
    cli: Any, shared_cases: Path, tmp_path: Path, case: str, code: int, said: str
) -> None:
    outcome = run(cli, shared_cases / case, tmp_path)
    assert said in outcome.out + outcome.err
    assert outcome.code == code


def test_no_scale_makes_metres_of_degrees(cli: Any, shared_cases: Path, tmp_path: Path) -> None:
    config = shared_cases / "las-wgs84-degrees" / "config.toml"
    for command in ("plan", "run"):
        outcome = cli(command, config, "-o", tmp_path / "run", "--set", "ingest.scale='search'")
        assert_one_line(outcome, 1, "x and y are degrees (WGS 84")


def test_draco_without_its_library(
    cli: Any, shared_cases: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = shared_cases / "model-glb-draco"
    monkeypatch.setattr("spinpipe.stages.ingest.readers.mesh._has_draco", lambda: False)
    outcome = run(cli, case, tmp_path)
    assert outcome.code == 1
    assert "compressed with Draco; install DracoPy" in outcome.err
    monkeypatch.undo()
    outcome = run(cli, case, tmp_path)
    assert outcome.code == 0, outcome.err
