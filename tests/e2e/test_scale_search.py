"""A scene in an unknown unit: the object that is looked for tells it."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.e2e.refusals import assert_one_line

from spinpipe.pipeline import scale_search

if TYPE_CHECKING:
    from tests.conftest import Cli, Yard

METRES_A_UNIT = 4.0
"""Most factors below make the yard smaller than the car: quickly done with."""


@pytest.fixture(autouse=True)
def fewer_factors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a decade around the right one instead of more than one."""
    monkeypatch.setattr(scale_search, "LOWEST", 2.9)


def written(yard: Yard, folder: Path, rows: slice | np.ndarray = slice(None)) -> Path:
    config = yard.write(folder, yard.xyz[rows] / METRES_A_UNIT)
    text = config.read_text()
    config.write_text(text.replace('scene = "scene.ply"', 'scene = "scene.ply"\nscale = "search"'))
    return config


def test_the_scale_is_found_noted_and_kept(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    config, output = written(yard, tmp_path), tmp_path / "run"
    arguments = (config, "-o", output)

    planned = cli("plan", *arguments)
    assert planned.code == 0, planned.err
    assert "the scale is searched first" in planned.out

    first = cli("run", *arguments, "--rerun", "off")
    assert first.code == 0, first.err
    assert "searched first" in first.out
    resolved = tomllib.loads((output / "config.resolved.toml").read_text())
    assert resolved["ingest"]["scale"] == pytest.approx(METRES_A_UNIT, rel=0.02)
    detections = json.loads((output / "detections.json").read_text())["detections"]
    assert sum(d["fate"] == "accepted" for d in detections) == len(yard.cars)
    notes = json.loads((output / "report.json").read_text())["stages"][0]["notes"]
    assert "searched: 2 instances" in notes[0]
    assert not list(output.glob(".scratch*"))

    again = cli("run", *arguments, "--rerun", "off", "--set", "verify.evidence.min_score=0.6")
    assert again.code == 0, again.err
    assert "searched first" not in again.out
    assert "reuse ingest" in again.out
    assert "reuse" in cli("plan", *arguments).out

    (output / "scale.json").write_text('{"scale": 1.0, "note": ""}')  # not what we wrote
    assert "the scale is searched first" in cli("plan", *arguments).out


def test_without_the_object_there_is_no_scale(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    xy = yard.xyz[:, :2]
    away = [np.linalg.norm(xy - (x, y), axis=1) > 3 for x, y, _ in yard.cars]
    config = written(yard, tmp_path, np.logical_and.reduce(away))
    outcome = cli("run", config, "-o", tmp_path / "run", "--rerun", "off")
    assert_one_line(outcome, 1, "scale search found nothing", "scale_from")
    assert not (tmp_path / "run").exists()
