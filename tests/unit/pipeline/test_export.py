"""The result files: what they hold, and that another program understands them."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from plyfile import PlyData
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from spinpipe.pipeline.export import export_results
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import DETECTIONS, MODELS
from spinpipe.schemas.records import Detection, ObjectModel, Part
from spinpipe.schemas.topics import Topic
from spinpipe.stages.geometry.frames import transform, yaw_matrix

if TYPE_CHECKING:
    from tests.conftest import Yard, YardRun

SQUARE = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], np.float32)
PLATE = ObjectModel(
    name="plate",
    points=SQUARE,
    normals=np.zeros((4, 3), np.float32),
    vertices=SQUARE,
    faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    T_object_model=np.diag([0.1, 0.1, 0.1, 1.0]),
    visible_from="all",
)
CLOUD = replace(PLATE, name="cloud", vertices=np.empty((0, 3), np.float32), faces=PLATE.faces[:0])


def detection(number: int = 0, fate: str = "accepted", model: str = "plate") -> Detection:
    pose = yaw_matrix(90.0, np.array([5.0, 6.0, 0.0]))
    return Detection(
        id=number,
        cluster=number,
        model=model,
        fate=fate,
        reason="because",
        T_world_object=pose,
        T_scene_model=pose @ PLATE.T_object_model,
        position_world=(5.0, 6.0, 0.0),
        position_scene=(5.0, 6.0, 0.0),
        heading_deg=90.0,
        heading_margin=float("inf"),
        correlation=0.9,
        rms_m=0.05,
        inliers=400,
        runner_up_heading_deg=270.0,
        runner_up_rms_m=float("nan"),
        coverage_model=0.9,
        coverage_scene=0.8,
        observed=1.0,
        score=0.75,
        parts=(Part("coverage", 0.9),),
        size_m=(2.0, 1.0, 0.0),
    )


def export(folder: Path, detections: list[Detection]) -> RunFolder:
    def read(topic: Topic[Any]) -> list[Any]:
        return {DETECTIONS.name: detections, MODELS.name: [PLATE, CLOUD]}[topic.name]

    run = RunFolder(folder)
    assert export_results("lot", read, run) == detections
    return run


def test_json_holds_every_candidate_and_is_strict_json(tmp_path: Path) -> None:
    run = export(tmp_path, [detection(0), detection(1, "rejected"), detection(2, "ambiguous")])
    text = run.detections_json.read_text()
    document = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert document["schema"] == 1
    assert document["run"] == "lot"
    assert [d["fate"] for d in document["detections"]] == ["accepted", "rejected", "ambiguous"]
    first = document["detections"][0]
    assert {
        *("id", "model", "fate", "reason", "position_world", "position_scene", "heading_deg"),
        *("heading_margin", "quaternion_xyzw", "T_scene_model", "correlation", "rms_m"),
        *("coverage_model", "coverage_scene", "score"),
    } <= set(first)
    assert first["heading_margin"] is None
    assert first["runner_up"]["rms_m"] is None
    assert first["parts"] == {"coverage": 0.9}


def test_the_quaternion_turns_by_the_heading(tmp_path: Path) -> None:
    document = json.loads(export(tmp_path, [detection()]).detections_json.read_text())
    turned = Rotation.from_quat(document["detections"][0]["quaternion_xyzw"]).apply([1, 0, 0])
    np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-12)


def test_csv_has_one_row_for_each_accepted(tmp_path: Path) -> None:
    run = export(tmp_path, [detection(0), detection(1, "rejected"), detection(7)])
    with run.detections_csv.open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["id"] for row in rows] == ["0", "7"]
    assert float(rows[0]["x"]) == 5.0
    assert float(rows[0]["heading_deg"]) == 90.0


def test_no_detection_is_a_header_an_empty_list_and_an_empty_ply(tmp_path: Path) -> None:
    run = export(tmp_path, [])
    assert json.loads(run.detections_json.read_text())["detections"] == []
    assert len(run.detections_csv.read_text().splitlines()) == 1
    assert PlyData.read(str(run.detections_ply))["vertex"].count == 0


def test_the_ply_shows_meshes_and_clouds_at_their_poses(tmp_path: Path) -> None:
    run = export(tmp_path, [detection(0), detection(1, "rejected"), detection(2, model="cloud")])
    ply = PlyData.read(str(run.detections_ply))
    assert ply["vertex"].count == 8
    assert ply["face"].count == 2
    xyz = np.column_stack([ply["vertex"][axis] for axis in "xyz"])
    np.testing.assert_allclose(xyz[1], [5, 8, 0], atol=1e-6)  # 2 m ahead, turned to +y
    assert max(int(i) for face in ply["face"]["vertex_indices"] for i in face) < 8


def test_results_appear_whole(tmp_path: Path) -> None:
    export(tmp_path, [detection()])
    assert list(tmp_path.glob("*.partial")) == []


def test_positions_and_transforms_of_a_run_agree(finished_yard: YardRun, yard: Yard) -> None:
    accepted = [d for d in finished_yard.detections() if d["fate"] == "accepted"]
    assert len(accepted) == len(yard.cars)
    scene = KDTree(yard.xyz)
    low, high = yard.model.min(axis=0), yard.model.max(axis=0)
    base = np.array([[(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]])
    for d in accepted:
        T = np.array(d["T_scene_model"])
        np.testing.assert_allclose(transform(T, base)[0], d["position_scene"], atol=1e-6)
        distance, _ = scene.query(transform(T, yard.model))
        assert np.median(distance) < 0.15
