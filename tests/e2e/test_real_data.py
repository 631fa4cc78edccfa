"""Whole runs over real reconstructions, judged by their labels."""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import CAMERAS, PLANE, SCENE, TILES, TRAJECTORY, UPRIGHT
from spinpipe.stages.geometry.frames import transform, world_from_scene

if TYPE_CHECKING:
    from tests.conftest import Cli, Outcome

takes_minutes = pytest.mark.skipif(
    not os.environ.get("SPINPIPE_ALL_DATA"), reason="two minutes; SPINPIPE_ALL_DATA=1 runs it"
)
CARPARK = Path(__file__).parents[2] / "recordings" / "carpark.toml"


def need(path: Path) -> Path:
    if not path.exists():
        pytest.skip(f"{path.name} is not here")
    return path


def run(cli: Cli, scene: Path, output: Path, *options: str) -> Outcome:
    outcome: Outcome = cli(
        *("run", CARPARK, "--rerun", "off", "-o", output, "--set", f"ingest.scene={scene}"),
        *options,
    )
    assert outcome.code == 0, outcome.err
    return outcome


def found_in(cli: Cli, scene: Path, truth: Path, output: Path) -> dict[str, Any]:
    """What a run over a car park accepts, by its labels."""
    run(cli, scene, output)
    outcome = cli("eval", output, "--truth", truth, "--any-model")
    assert outcome.code == 0, outcome.err
    return json.loads((output / "eval.json").read_text())


def part_of(scene: Path, to: Path, kept: Callable[[NDArray[Any]], NDArray[Any]]) -> Path:
    """A scene of some of the points of another one."""
    rows = PlyData.read(scene)["vertex"].data
    PlyData([PlyElement.describe(rows[kept(rows)], "vertex")]).write(to)
    return to


def test_a_car_park_gives_its_cars(cli: Cli, shared_data: Path, tmp_path: Path) -> None:
    """Its northern half, which is as good a witness as the whole."""
    folder, south_m = need(shared_data / "photo-west"), 553.0
    with (folder / "truth.csv").open() as file:
        labels = [label for label in csv.DictReader(file) if float(label["y"]) > south_m - 3]
    for label in labels:
        if float(label["y"]) < south_m + 3:
            label["ignore"] = "1"
    truth = tmp_path / "truth.csv"
    with truth.open("w", newline="") as file:
        table = csv.DictWriter(file, labels[0])
        table.writeheader()
        table.writerows(labels)
    scene = part_of(folder / "scene.ply", tmp_path / "scene.ply", lambda rows: rows["y"] > south_m)
    report = found_in(cli, scene, truth, tmp_path / "run")
    cars = report["labels"]["counted"]
    assert cars > 12
    assert report["accepted"]["recall"] * cars >= cars - 1
    assert len(report["false"]) <= 1


@takes_minutes
@pytest.mark.parametrize(("name", "cars"), [("photo-west", 32), ("lot-north", 71)])
def test_a_whole_car_park_gives_its_cars(
    cli: Cli, shared_data: Path, tmp_path: Path, name: str, cars: int
) -> None:
    folder = need(shared_data / name)
    report = found_in(cli, folder / "scene.ply", folder / "truth.csv", tmp_path / "run")
    assert report["labels"]["counted"] == cars
    assert report["accepted"]["recall"] >= 0.95
    assert report["accepted"]["precision"] >= 0.95


@takes_minutes
@pytest.mark.parametrize(
    ("scene", "at", "size", "heading"),
    [
        ("bus-yard/scene.ply", (376.25, 631.85), "18.6,2.9,3.6", "85"),
        ("prisms-north/scene.laz", (232.92, 190.73, 40.3), "9.0,3.4,4.2", "6.1"),
    ],
)
def test_a_cut_model_is_found_at_its_own_place(
    cli: Cli, shared_data: Path, tmp_path: Path, scene: str, at: tuple[float, ...], size: str,
    heading: str,
) -> None:  # fmt: skip
    source, model, config = need(shared_data / scene), tmp_path / "cut.ply", tmp_path / "c.toml"
    run(cli, source, tmp_path / "first", "--until", "ground")
    outcome = cli(
        *("model", "cut", tmp_path / "first", "--at", ",".join(map(str, at)), "--size", size),
        *("--heading", heading, "--name", "thing", "--out", model),
    )
    assert outcome.code == 0, outcome.err
    config.write_text(
        f'[ingest]\nscene = "{source}"\n'
        '[[model]]\nname = "thing"\npath = "cut.ply"\nvisible_from = "above"\n'
    )
    outcome = cli("run", config, "--rerun", "off", "-o", tmp_path / "run")
    assert outcome.code == 0, outcome.err
    found = json.loads((tmp_path / "run" / "detections.json").read_text())["detections"]
    own = [d for d in found if math.dist(d["position_scene"][:2], at[:2]) < 1]
    assert max(d["score"] for d in own if d["fate"] == "accepted") >= 0.9


def test_a_colmap_model_comes_with_its_cameras(cli: Cli, shared_data: Path, tmp_path: Path) -> None:
    scene = need(shared_data / "brighton" / "colmap_sparse")
    run(cli, scene, tmp_path / "run", "--until", "ground")
    read = RunReader(RunFolder(tmp_path / "run"))
    (frame,), (upright,), (cameras,) = read(SCENE), read(UPRIGHT), read(CAMERAS)
    assert frame.points + frame.duplicates == 6847
    assert len(cameras.positions) == 18
    T = world_from_scene(frame, upright)
    up = np.linalg.inv(T[:3, :3]) @ [0, 0, 1]
    assert up[2] > np.cos(np.radians(3)), "its file is local east-north-up"
    heights = transform(upright.T_world_local, cameras.positions)[:, 2]
    assert heights.min() > 35
    assert heights.max() < 60


def test_a_lidar_log_becomes_a_scene_that_stands(
    cli: Cli, shared_data: Path, tmp_path: Path
) -> None:
    scene = need(shared_data / "mcap-ouster" / "pointcloudset_test.mcap")
    run(cli, scene, tmp_path / "run", "--until", "ground")
    read = RunReader(RunFolder(tmp_path / "run"))
    (frame,), (upright,), (path,) = read(SCENE), read(UPRIGHT), read(TRAJECTORY)
    assert 10_000 < frame.points < 40_000
    assert len(path.positions) == 2
    np.testing.assert_allclose(path.positions[1], path.positions[0], atol=0.1, err_msg="it stood")
    assert path.times_ns[1] - path.times_ns[0] == pytest.approx(1e8, rel=0.02)
    assert upright.T_world_local[2, 2] > np.cos(np.radians(2)), "and upright"


def test_a_pmvs_cloud_runs_to_the_end(cli: Cli, shared_data: Path, tmp_path: Path) -> None:
    whole = need(shared_data / "brighton" / "pmvs" / "scene_binary.ply")
    part_of(whole, tmp_path / "scene.ply", lambda rows: np.arange(len(rows)) % 16 == 0)
    config = tmp_path / "config.toml"
    config.write_text("[ingest]\nscene = 'scene.ply'\n[[model]]\nname = 'car'\nshape = 'saloon'\n")
    outcome = cli("run", config, "--rerun", "off", "-o", tmp_path / "run")
    assert outcome.code == 0, outcome.err
    read = RunReader(RunFolder(tmp_path / "run"))
    assert 36_500 < read(SCENE)[0].points < 37_500
    assert read(TILES)[0].counts.sum() == read(SCENE)[0].points
    assert read(PLANE)[0].normal[2] > np.cos(np.radians(5))
    assert (tmp_path / "run" / "detections.json").exists()


@pytest.mark.parametrize(
    "name",
    [
        "formats/laspy_las/simple.las",
        "formats/laspy_las/autzen_trim.laz",
        "formats/odm_laz/brighton_small.laz",
        "formats/colmap_fused_crlf/fused.ply",
        "formats/colmap_old_bin/sparse/0",
        "brighton/pmvs/option-first30000.ply",
        "brighton/pmvs/scene_binary.ply",
        "brighton/odm_model.laz",
    ],
)
def test_files_of_other_programs_are_ingested(
    cli: Cli, shared_data: Path, tmp_path: Path, name: str
) -> None:
    scene = need(shared_data / name)
    outcome = cli(
        *("run", CARPARK, "--rerun", "off", "-o", tmp_path / "run", "--until", "ingest"),
        *("--set", f"ingest.scene={scene}", "--set", "ingest.scale=10"),
    )
    assert outcome.code == 0, outcome.err
    read = RunReader(RunFolder(tmp_path / "run"))
    assert read(SCENE)[0].points == read(TILES)[0].counts.sum() > 100
