"""Whole runs from the command line: what a user types, reads and finds in the folder."""

from __future__ import annotations

import csv
import hashlib
import json
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.conftest import Outcome
from tests.e2e.refusals import assert_one_line

from spinpipe.pipeline.config import SECTIONS, own_keys
from spinpipe.pipeline.demo import write_example
from spinpipe.stages import STAGES

if TYPE_CHECKING:
    from tests.conftest import Cli, SharedByWorkers, Yard, YardRun

NAMES = [stage.name for stage in STAGES]
FILES = [f"{i:02d}_{name}.mcap" for i, name in enumerate(NAMES, 1)]
RERUN = Path(sys.executable).with_name("rerun")


@pytest.fixture(scope="module")
def demo(
    cli: Cli, shared_by_workers: SharedByWorkers, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Outcome, Path]:
    """The example that ships, with its recording."""

    def make(folder: Path) -> None:
        outcome = cli("demo", cwd=folder)
        (folder / "outcome.json").write_text(json.dumps(asdict(outcome)))

    shared, own = shared_by_workers("demo", make), tmp_path_factory.mktemp("demo")
    shutil.copytree(shared, own, dirs_exist_ok=True)
    return Outcome(**json.loads((own / "outcome.json").read_text())), own / "recordings" / "demo"


def found(output: Path) -> list[dict[str, Any]]:
    detections = json.loads((output / "detections.json").read_text())["detections"]
    return [d for d in detections if d["fate"] == "accepted"]


def digests(folder: Path, names: list[str]) -> dict[str, str]:
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names}


# The example that ships


def test_demo_finds_the_four_cars_of_model_1_and_no_others(demo: tuple[Outcome, Path]) -> None:
    outcome, output = demo
    assert outcome.code == 0, outcome.err
    assert "accepted: 4 model_1" in outcome.out
    with (output / "truth.csv").open() as stream:
        truth = [row for row in csv.DictReader(stream) if row["model"] == "model_1"]
    assert len(truth) == len(found(output)) == 4
    places = np.array([d["position_scene"] for d in found(output)])
    for row in truth:
        place = np.array([float(row[axis]) for axis in "xyz"])
        nearest = int(np.argmin(np.linalg.norm(places - place, axis=1)))
        assert np.linalg.norm(places[nearest] - place) < 0.1
        turned = found(output)[nearest]["heading_deg"] - float(row["heading_deg"])
        assert abs((turned + 180) % 360 - 180) < 10


def test_demo_leaves_the_files_of_a_run_and_nothing_else(demo: tuple[Outcome, Path]) -> None:
    _, output = demo
    example = {"scene.ply", "model_1.ply", "model_2.ply", "truth.csv", "config.toml"}
    results = {"detections.json", "detections.csv", "detections.ply", "report.json"}
    results |= {"detections.png", "report.html"}
    others = {"run.rrd", "config.resolved.toml", ".lock", ".spinpipe"}
    assert {path.name for path in output.iterdir()} == {*FILES, *example, *results, *others}


def test_the_example_is_the_same_bytes_every_time(
    demo: tuple[Outcome, Path], tmp_path: Path
) -> None:
    names = ["scene.ply", "model_1.ply", "model_2.ply", "truth.csv"]
    write_example(tmp_path)
    assert digests(tmp_path, names) == digests(demo[1], names)


def test_a_second_demo_reuses_everything_but_from_forces_it(
    cli: Cli, demo: tuple[Outcome, Path]
) -> None:
    _, output = demo
    before = digests(output, [*FILES, "detections.json", "run.rrd"])
    again = cli("demo", "-o", output)
    assert re.findall(r"^(\w+)", again.out, re.MULTILINE)[:5] == ["reuse"] * 5
    assert digests(output, list(before)) == before


@pytest.mark.skipif(not RERUN.exists(), reason="the viewer's command is not installed")
def test_other_programs_accept_the_files(demo: tuple[Outcome, Path]) -> None:
    _, output = demo
    for name in FILES:
        subprocess.run([RERUN, "mcap", "check", output / name], check=True, capture_output=True)
    subprocess.run([RERUN, "rrd", "verify", output / "run.rrd"], check=True, capture_output=True)


def test_record_draws_the_same_recording_without_computing(
    cli: Cli, demo: tuple[Outcome, Path]
) -> None:
    _, output = demo
    size = (output / "run.rrd").stat().st_size
    (output / "run.rrd").unlink()
    before = digests(output, FILES)
    outcome = cli("record", output)
    assert outcome.code == 0, outcome.err
    assert (output / "run.rrd").stat().st_size == pytest.approx(size, rel=0.05)
    assert digests(output, FILES) == before


def test_the_report_says_what_ran_and_with_what(demo: tuple[Outcome, Path]) -> None:
    report = json.loads((demo[1] / "report.json").read_text())
    assert [stage["stage"] for stage in report["stages"]] == NAMES
    assert {"numpy", "mcap", "spinpipe"} <= set(report["libraries"])


# A user's own config


def test_init_writes_a_config_that_runs(cli: Cli, tmp_path: Path) -> None:
    outcome = cli("init", "lot/config.toml", cwd=tmp_path)
    assert outcome.code == 0, outcome.err
    assert "spinpipe run lot/config.toml" in outcome.out
    ran = cli("run", "lot/config.toml", "--until", "ingest", "--rerun", "off", cwd=tmp_path)
    assert ran.code == 0, ran.err
    assert (tmp_path / "recordings" / "config" / "01_ingest.mcap").exists()


def test_init_for_ones_own_scene_runs_to_the_end(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path)
    (tmp_path / "config.toml").unlink()
    outcome = cli("init", "--scene", "scene.ply", "--model", "saloon.ply", cwd=tmp_path)
    assert outcome.code == 0, outcome.err
    ran = cli("run", "config.toml", "--rerun", "off", cwd=tmp_path)
    assert ran.code == 0, ran.err
    assert len(found(tmp_path / "recordings" / "config")) == len(yard.cars)


def test_init_overwrites_nothing(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "config.toml").write_text("mine")
    outcome = cli("init", cwd=tmp_path)
    assert_one_line(outcome, 1, "is there already")
    assert (tmp_path / "config.toml").read_text() == "mine"
    assert_one_line(cli("init", "new.toml", "--scene", "a.ply", cwd=tmp_path), 2, "--model")
    assert {path.name for path in tmp_path.iterdir()} == {"config.toml"}


def test_init_looks_at_scene_and_models_and_fills_in(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    """A scene in feet by its own words, a model whose up could be another, a shape that ships."""
    vertices = [(x, y, z) for x in (0, 4) for y in (0, 1.5) for z in (0, 1.5)]
    faces = [(1, 2, 4), (1, 4, 3), (5, 6, 8), (5, 8, 7), (1, 2, 6), (1, 6, 5), (3, 4, 8), (3, 8, 7)]
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces]
    (tmp_path / "beam.obj").write_text("\n".join(lines))
    yard.write(tmp_path, yard.xyz / 0.3048)
    data = (tmp_path / "scene.ply").read_bytes()
    (tmp_path / "feet.ply").write_bytes(
        data.replace(b"\nelement", b"\ncomment unit: ft\nelement", 1)
    )
    what = ("--model", "beam.obj", "--shape", "saloon")
    outcome = cli("init", "lot/a.toml", "--scene", "feet.ply", *what, cwd=tmp_path)
    assert outcome.code == 0, outcome.err
    assert "model beam: 4 x 1.5 x 1.5 m" in outcome.out
    document = tomllib.loads((tmp_path / "lot" / "a.toml").read_text())
    assert (document["ingest"]["scene"], document["ingest"]["scale"]) == ("../feet.ply", 0.3048)
    beam, saloon = document["model"]
    assert beam == {"name": "beam", "path": "../beam.obj", "up": "z", "stretch": 0.1,
                    "visible_from": "above"}  # fmt: skip
    assert saloon["shape"] == "saloon"
    planned = cli("plan", "lot/a.toml", cwd=tmp_path)
    assert planned.code == 0, planned.err
    assert "- model beam: 4 x 1.5 x 1.5 m" in planned.out


def test_init_and_plan_refuse_what_run_would(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    config = yard.write(tmp_path, yard.xyz * 1000)
    for command in (
        ("init", "new.toml", "--scene", "scene.ply", "--shape", "saloon"),
        ("plan", config),
    ):
        outcome = cli(*command, cwd=tmp_path)
        assert outcome.code == 1
        assert "try [ingest] scale = 0.001 for millimetres" in outcome.err
    assert not (tmp_path / "new.toml").exists()
    stated = ("--set", "ingest.scale=0.001")
    outcome = cli(
        "init", "new.toml", "--scene", "scene.ply", "--shape", "saloon", *stated, cwd=tmp_path
    )
    assert outcome.code == 0, outcome.err
    assert tomllib.loads((tmp_path / "new.toml").read_text())["ingest"]["scale"] == 0.001


def test_init_writes_a_preset(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path)
    outcome = cli("init", "a.toml", "--preset", "carpark", "--scene", "scene.ply", cwd=tmp_path)
    assert outcome.code == 0, outcome.err
    document = tomllib.loads((tmp_path / "a.toml").read_text())
    assert document["ingest"]["scene"] == "scene.ply"
    assert len(document["model"]) == 6
    assert_one_line(cli("init", "b.toml", "--preset", "x", cwd=tmp_path), 2, "there are carpark")


def test_plan_says_what_would_run_and_does_nothing(cli: Cli, yard_run: YardRun) -> None:
    before = sorted(yard_run.output.iterdir())
    outcome = cli("plan", yard_run.config, "-o", yard_run.output, "--set", "verify.icp.samples=300")
    lines = dict(line.split(maxsplit=1) for line in outcome.out.splitlines()[1:7])
    assert [text.split()[0] for text in lines.values()] == ["reuse"] * 5 + ["run"]
    assert "[verify.icp] samples changed" in lines["verify"]
    assert sorted(yard_run.output.iterdir()) == before


def test_plan_of_a_new_run_makes_no_folder(cli: Cli, yard_run: YardRun, tmp_path: Path) -> None:
    outcome = cli("plan", yard_run.config, "-o", tmp_path / "new")
    assert outcome.code == 0
    assert not (tmp_path / "new").exists()


def test_stages_explains_every_stage_and_key(cli: Cli) -> None:
    outcome = cli("stages")
    assert outcome.code == 0
    for stage in STAGES:
        assert f"\n{stage.name}: " in outcome.out
    for section in SECTIONS.values():
        for key in own_keys(section):
            assert re.search(rf"^  {key} ", outcome.out, re.MULTILINE), key


def test_stages_prints_brackets_as_they_are(cli: Cli) -> None:
    assert "[x, y, z]" in cli("stages").out


def test_overrides_may_name_paths_relative_to_the_current_folder(
    cli: Cli, yard: Yard, yard_run: YardRun, tmp_path: Path
) -> None:
    here = tmp_path / "here"
    yard.write(here, yard.xyz + [5.0, 0.0, 0.0])
    outcome = cli(
        *("run", yard_run.config, "--rerun", "off", "-o", "out"),
        *("--set", "ingest.scene=scene.ply", "--set", "run.name=moved", "--set", "run.seed=3"),
        cwd=here,
    )
    assert outcome.code == 0, outcome.err
    places = [d["position_scene"][0] - 5.0 for d in found(here / "out")]
    np.testing.assert_allclose(sorted(places), sorted(car[0] for car in yard.cars), atol=0.1)
    resolved = tomllib.loads((here / "out" / "config.resolved.toml").read_text())
    assert resolved["ingest"]["scene"] == str(here / "scene.ply")
    assert resolved["run"] == {"name": "moved", "seed": 3}


def test_the_resolved_config_repeats_the_run(cli: Cli, yard_run: YardRun) -> None:
    resolved = yard_run.output / "config.resolved.toml"
    outcome = cli("plan", resolved, "-o", yard_run.output)
    assert outcome.out.count("reuse") == len(NAMES)


def test_a_scene_without_any_hit_is_a_result(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    ground = yard.xyz[yard.xyz[:, 2] < 0.05]
    config = yard.write(tmp_path, ground, "\n[ground]\nup = [0, 0, 1]\n")
    outcome = cli("run", config, cwd=tmp_path)
    assert outcome.code == 0, outcome.err
    assert outcome.err == ""
    assert "no detections" in outcome.out
    output = tmp_path / "recordings" / "config"
    assert found(output) == []
    assert len((output / "detections.csv").read_text().splitlines()) == 1
    assert (output / "run.rrd").exists()


# The terminal


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        *([command, "--help"] for command in ("run", "plan", "init", "demo", "record", "stages")),
        ["stages"],
    ],
    ids=" ".join,
)
def test_text_fits_eighty_columns(
    cli: Cli, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    outcome = cli(*arguments)
    assert outcome.code == 0
    assert max(len(line.rstrip()) for line in outcome.out.splitlines()) <= 80


def test_the_table_fits_eighty_columns(demo: tuple[Outcome, Path]) -> None:
    lines = demo[0].out.splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("id "))
    lines = [line for line in lines[first:] if "results in" not in line]
    assert max(len(line.rstrip()) for line in lines) <= 80


def test_the_version_is_told(cli: Cli) -> None:
    assert re.fullmatch(r"spinpipe \d+\.\d+\.\d+\S*\n", cli("--version").out)
