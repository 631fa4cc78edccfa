"""spinpipe from Python: a run opened, and objects found in arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from spinpipe.pipeline import api
from spinpipe.pipeline.config import ConfigError
from spinpipe.schemas import HITS
from spinpipe.stages.stage import StageError

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import Yard, YardRun


def test_a_run_is_opened(finished_yard: YardRun, yard: Yard) -> None:
    run = api.open(finished_yard.output)
    by_file = finished_yard.detections()
    assert [d.id for d in run.detections] == [d["id"] for d in by_file]
    assert len(run.accepted) == len(yard.cars)
    table = run.table(["accepted", "rejected", "ambiguous", "duplicate"])
    assert set(table["id"]) == {d["id"] for d in by_file}
    np.testing.assert_allclose(
        np.column_stack([table[f"{axis}_scene"] for axis in "xyz"]),
        [d["position_scene"] for d in by_file],
    )
    assert run.config.run.name == "yard"
    assert run.found.notes["verify"]
    assert "2 of" in repr(run)


def test_the_cloud_comes_in_both_frames(finished_yard: YardRun, yard: Yard) -> None:
    run = api.open(finished_yard.output)
    scene, world = run.cloud(), run.cloud("world")
    assert scene.xyz.shape == scene.rgb.shape == yard.xyz.shape
    np.testing.assert_allclose(np.sort(scene.xyz[:, 0]), np.sort(yard.xyz[:, 0]), atol=1e-4)
    moved = scene.xyz @ run.T_world_scene[:3, :3].T + run.T_world_scene[:3, 3]
    np.testing.assert_allclose(moved, world.xyz, atol=1e-4)
    with pytest.raises(ValueError, match="frame"):
        run.cloud("camera")


def test_topics_are_read_by_name(finished_yard: YardRun) -> None:
    run = api.open(finished_yard.output)
    assert len(run.topic("/scan/hits")) == len(run.topic(HITS)) == 1
    with pytest.raises(StageError, match="/verify/detections"):
        run.topic("/no/such")


def test_no_run_is_said_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no run here"):
        api.open(tmp_path)


def test_cars_are_found_in_an_array_as_by_a_run(yard: Yard, finished_yard: YardRun) -> None:
    scan = {"radius_m": 2.5, "height_m": 1.0, "bin_m": 0.2}
    found = api.find(yard.xyz, {"saloon": yard.model}, scan=scan)
    by_run = api.open(finished_yard.output).accepted
    places = np.array([d.position_scene for d in found.accepted])
    assert len(places) == len(by_run)
    for d in by_run:
        assert np.linalg.norm(places - d.position_scene, axis=1).min() < 0.05


def test_a_wrong_key_is_named(yard: Yard) -> None:
    with pytest.raises(ConfigError, match="no_such_key"):
        api.find(yard.xyz, {"saloon": "saloon"}, scan={"no_such_key": 1})
