"""Tools around recognition from the command line: eval, plant, model cut, paper."""

from __future__ import annotations

import csv
import json
import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from spinpipe.pipeline.evaluation import experiments, paper
from spinpipe.pipeline.scenes.artificial import make_scene
from spinpipe.stages.ingest.readers.open_scene import open_scene

if TYPE_CHECKING:
    from tests.conftest import Cli, Yard, YardRun


def write_truth(path: Path, rows: list[tuple[Any, ...]], header: str) -> Path:
    with path.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(header.split(","))
        table.writerows(rows)
    return path


def labels(yard: Yard, folder: Path, *more: tuple[Any, ...], only: int = 2) -> Path:
    rows = [("saloon", *car, 0) for car in yard.cars[:only]]
    return write_truth(folder / "truth.csv", [*rows, *more], "model,x,y,heading_deg,ignore")


def report(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "eval.json").read_text())


def test_eval_says_how_good_a_run_is(cli: Cli, yard: Yard, yard_run: YardRun) -> None:
    truth = labels(yard, yard_run.folder)
    outcome = cli("eval", yard_run.output, "--truth", truth, "--picture", yard_run.folder / "a.png")
    assert outcome.code == 0, outcome.err
    assert max(map(len, outcome.out.splitlines()[:-2])) <= 80
    found = report(yard_run.output)
    assert found["match"]["model"] == "name"
    assert found["accepted"]["recall"] == 1.0
    assert found["accepted"]["precision"] == 1.0
    assert found["accepted"]["flipped"] == 0
    assert found["accepted"]["errors"]["position_m"]["largest"] < 0.3
    assert Image.open(yard_run.folder / "a.png").width > 300


def test_eval_names_the_stage_of_each_miss_and_what_is_false(
    cli: Cli, yard: Yard, yard_run: YardRun
) -> None:
    truth = labels(yard, yard_run.folder, ("saloon", -4.0, 4.0, 0.0, 0), only=1)
    outcome = cli("eval", yard_run.output, "--truth", truth)
    assert outcome.code == 0, outcome.err
    found = report(yard_run.output)
    (miss,) = found["missed"]
    assert (miss["line"], miss["stage"]) == (3, "scan")
    (false,) = found["false"]
    assert false["kind"] == "clutter"
    assert found["accepted"]["recall"] == found["accepted"]["precision"] == 0.5


def test_eval_leaves_ignored_labels_alone(cli: Cli, yard: Yard, yard_run: YardRun) -> None:
    truth = labels(yard, yard_run.folder, ("saloon", *yard.cars[1], 1), only=1)
    cli("eval", yard_run.output, "--truth", truth, "--json", yard_run.folder / "other.json")
    found = json.loads((yard_run.folder / "other.json").read_text())
    assert found["accepted"]["on_ignored"] == 1
    assert found["accepted"]["precision"] == 1.0


@pytest.mark.parametrize(
    ("header", "row", "says"),
    [("model,x", ("car", 1), "no column 'y'"), ("x,y", (1, "a"), "line 2: y = 'a' is no number")],
)
def test_eval_refuses_bad_labels_in_one_line(
    cli: Cli, yard_run: YardRun, header: str, row: tuple[Any, ...], says: str
) -> None:
    truth = write_truth(yard_run.folder / "bad.csv", [row], header)
    outcome = cli("eval", yard_run.output, "--truth", truth)
    assert outcome.code == 1
    assert says in outcome.err
    assert outcome.err.count("\n") == 1


def test_eval_refuses_a_folder_without_a_run(cli: Cli, tmp_path: Path) -> None:
    truth = write_truth(tmp_path / "truth.csv", [(0, 0)], "x,y")
    outcome = cli("eval", tmp_path, "--truth", truth)
    assert outcome.code == 2
    assert "no run here" in outcome.err


def test_cut_model_finds_its_own_kind(cli: Cli, yard: Yard, yard_run: YardRun) -> None:
    x, y, heading = yard.cars[0]
    out = yard_run.folder / "cut.ply"
    outcome = cli(
        *("model", "cut", yard_run.output, "--at", f"{x},{y}", "--heading", heading),
        *("--size", "4.6,1.9,1.6", "--name", "mine", "--out", out),
    )
    assert outcome.code == 0, outcome.err
    points = np.concatenate([xyz for xyz, _ in open_scene(out).chunks(10_000)])
    assert points[:, 2].min() > 0.02  # no ground
    assert np.ptp(points[:, 0]) == pytest.approx(np.ptp(yard.model[:, 0]), abs=0.15)
    config = yard_run.config
    config.write_text(config.read_text().replace("saloon.ply", "cut.ply"))
    outcome = cli("run", config, "--rerun", "off", "-o", yard_run.output)
    assert outcome.code == 0, outcome.err
    cli("eval", yard_run.output, "--truth", labels(yard, yard_run.folder))
    assert report(yard_run.output)["accepted"]["recall"] == 1.0
    own = [d for d in yard_run.detections() if math.dist(d["position_scene"][:2], (x, y)) < 1]
    assert max(d["score"] for d in own if d["fate"] == "accepted") >= 0.9


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("--at", "500,500", "--size", "4,2,1.5"), 1, "0 points stand there"),
        (("--at", "1", "--size", "4,2,1.5"), 2, "write x,y or x,y,z"),
        (("--at", "1,2", "--size", "4,-2,1.5"), 2, "must be above 0"),
        (("--at", "1,2", "--size", "4,2,1.5", "--name", "a b"), 2, "may hold only letters"),
        (("--at", "1,2", "--size", "4,2,1.5", "--out", "a.obj"), 2, "name a .ply file"),
    ],
)
def test_cut_refuses_in_one_line(
    cli: Cli, finished_yard: YardRun, arguments: tuple[str, ...], code: int, says: str
) -> None:
    outcome = cli("model", "cut", finished_yard.output, *arguments)
    assert (outcome.code, outcome.err.count("\n")) == (code, 1)
    assert says in outcome.err


def test_planted_objects_are_found(cli: Cli, yard_run: YardRun) -> None:
    outcome = cli("plant", yard_run.output, "--count", "2", "--seed", "1")
    assert outcome.code == 0, outcome.err
    folder = yard_run.output / "plant"
    planted = json.loads((folder / "plant.json").read_text())
    assert planted["by_visibility"]["all"]["planted"] >= 1
    assert planted["by_visibility"]["all"]["recall"] == 1.0
    assert planted["false"] == []
    for entry in planted["objects"]:
        assert entry["position_error_m"] < 0.3
        assert abs(entry["heading_error_deg"]) < 10
        assert entry["noise_m"] == pytest.approx(0.005, abs=0.004)
    before = (folder / "scene.ply").read_bytes(), (folder / "truth.csv").read_bytes()
    assert cli("plant", yard_run.output, "--count", "2", "--seed", "1").code == 0
    assert before == ((folder / "scene.ply").read_bytes(), (folder / "truth.csv").read_bytes())


def test_paper_writes_tables_and_figures(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiments, "make_scene", partial(make_scene, 15_000))
    monkeypatch.setattr(experiments, "MAX_CANDIDATES", 6)
    monkeypatch.setattr(paper, "NOISE_M", (0.1,))
    monkeypatch.setattr(paper, "SAMPLES", (50, 100))
    outcome = cli("paper", "-o", tmp_path / "out")
    assert outcome.code == 0, outcome.err
    text = (tmp_path / "out" / "paper.md").read_text()
    for section in ("3.1 Two bin sizes", "3.2 Seen from above", "3.3 Noise", "3.4 Residuals"):
        assert f"## {section}" in text
    pictures = {path.name for path in (tmp_path / "out").glob("*.png")}
    assert pictures == {
        *("paper_scene.png", "paper_noise_found.png"),
        *("paper_noise_false.png", "paper_residuals.png"),
    }
    assert all(f"]({name})" in text for name in pictures)
    assert not list((tmp_path / "out").glob(".scratch*"))


def test_paper_needs_scene_model_and_truth_together(cli: Cli, tmp_path: Path) -> None:
    outcome = cli("paper", "-o", tmp_path, "--scene", "a.ply")
    assert outcome.code == 2
    assert "belong together" in outcome.err
