"""The result files: what they hold, and that other programs understand them."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import laspy
import numpy as np
import pytest
import trimesh
from PIL import Image
from plyfile import PlyData
from pyproj import Geod, Transformer
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from shapely.geometry import shape

from spinpipe.pipeline.drawing.palette import ACCEPTED
from spinpipe.pipeline.results import formats
from spinpipe.pipeline.results.diff import compare
from spinpipe.pipeline.results.geojson import geojson
from spinpipe.pipeline.results.instances import row
from spinpipe.pipeline.results.life import limit_tests
from spinpipe.schemas.records import Detection, ObjectModel, Part, SceneFrame
from spinpipe.schemas.topics import Topic
from spinpipe.stages.geometry.frames import transform, yaw_matrix
from spinpipe.stages.stage import StageError
from spinpipe.stages.verify.verify import Verify

if TYPE_CHECKING:
    from tests.conftest import Cli, Yard, YardRun

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
        inlier_weight=400.0,
        runner_up_heading_deg=270.0,
        runner_up_rms_m=float("nan"),
        coverage_model=0.9,
        coverage_scene=0.8,
        observed=1.0,
        score=0.75,
        parts=(Part("coverage", 0.9),),
        size_m=(2.0, 1.0, 0.0),
    )


MODELS = {"plate": PLATE, "cloud": CLOUD}
SCENE = SceneFrame((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 4, 0, False, "made up")


def export(folder: Path, detections: list[Detection], name: str) -> Path:
    def read(topic: Topic[Any]) -> list[Any]:
        return {"/ingest/scene": [SCENE]}[topic.name]

    path = folder / f"out.{name}"
    formats.FORMATS[name](formats.Export("lot", detections, MODELS, read), path)
    return path


def test_json_holds_every_candidate_and_is_strict_json(tmp_path: Path) -> None:
    path = export(
        tmp_path, [detection(0), detection(1, "rejected"), detection(2, "ambiguous")], "json"
    )
    text = path.read_text()
    document = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert document["schema"] == 2
    assert document["run"] == "lot"
    assert [d["fate"] for d in document["detections"]] == ["accepted", "rejected", "ambiguous"]
    first = document["detections"][0]
    assert {
        *("id", "model", "fate", "reason", "position_world", "position_scene", "heading_deg"),
        *("heading_margin", "quaternion_xyzw", "T_scene_model", "correlation", "rms_m"),
        *("coverage_model", "coverage_scene", "score", "heading_scene_deg"),
    } <= set(first)
    assert first["heading_margin"] is None
    assert first["runner_up"]["rms_m"] is None
    assert first["parts"] == {"coverage": 0.9}
    assert first["heading_scene_deg"] == pytest.approx(90.0)


def test_the_quaternion_turns_by_the_heading(tmp_path: Path) -> None:
    document = json.loads(export(tmp_path, [detection()], "json").read_text())
    turned = Rotation.from_quat(document["detections"][0]["quaternion_xyzw"]).apply([1, 0, 0])
    np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-12)


def test_csv_names_the_frame_of_every_coordinate(tmp_path: Path) -> None:
    with export(tmp_path, [detection(0), detection(7)], "csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["id"] for row in rows] == ["0", "7"]
    assert float(rows[0]["x_scene"]) == 5.0
    assert float(rows[0]["heading_scene_deg"]) == 90.0
    assert rows[0]["heading_margin"] == ""  # infinite
    assert not {"x", "y", "z", "heading_deg"} & set(rows[0])


def test_a_scene_that_is_turned_has_another_heading_than_the_world() -> None:
    turned = replace(
        detection(), T_scene_model=yaw_matrix(30.0, np.zeros(3)) @ detection().T_scene_model
    )
    assert row(turned, MODELS)["heading_scene_deg"] == pytest.approx(120.0)
    on_end = replace(detection(), T_scene_model=np.eye(4)[[2, 1, 0, 3]] @ PLATE.T_object_model)
    assert np.isnan(row(on_end, MODELS)["heading_scene_deg"])


@pytest.mark.parametrize("name", ["csv", "json", "ply", "obj", "kitti"])
def test_no_detection_is_a_whole_file_of_every_format(tmp_path: Path, name: str) -> None:
    path = export(tmp_path, [], name)
    if name == "ply":
        assert PlyData.read(str(path))["vertex"].count == 0
    elif name == "json":
        assert json.loads(path.read_text())["detections"] == []
    else:
        assert len(path.read_text().splitlines()) == {"csv": 1, "obj": 1, "kitti": 0}[name]


def test_the_ply_knows_which_object_a_vertex_belongs_to(tmp_path: Path) -> None:
    ply = PlyData.read(str(export(tmp_path, [detection(4), detection(9, model="cloud")], "ply")))
    assert ply["vertex"].count == 8
    assert ply["face"].count == 2
    assert ply["vertex"]["object_id"].tolist() == [4] * 4 + [9] * 4
    xyz = np.column_stack([ply["vertex"][axis] for axis in "xyz"])
    np.testing.assert_allclose(xyz[1], [5, 8, 0], atol=1e-6)  # 2 m ahead, turned to +y
    assert max(int(i) for face in ply["face"]["vertex_indices"] for i in face) < 8


def test_the_obj_has_an_object_for_each_id(tmp_path: Path) -> None:
    path = export(tmp_path, [detection(4), detection(9)], "obj")
    both: Any = trimesh.load(path, process=False, force="mesh")
    assert [line for line in path.read_text().splitlines() if line.startswith("o ")] == [
        "o 4_plate",
        "o 9_plate",
    ]
    assert len(both.split(only_watertight=False)) == 2
    np.testing.assert_allclose(both.bounds, [[4, 6, 0], [5, 8, 0]], atol=1e-6)


def test_kitti_labels_give_back_the_pose(tmp_path: Path) -> None:
    fields = export(tmp_path, [detection()], "kitti").read_text().split()
    assert fields[0] == "plate"
    height, width, length, x, y, z, rotation_y, score = map(float, fields[8:])
    assert (height, width, length, score) == (0.0, 1.0, 2.0, 0.75)
    np.testing.assert_allclose([z, -x, -y], detection().position_world)
    # in KITTI the front is (cos ry, 0, -sin ry) in x right, y down, z ahead
    ahead = np.array([-np.sin(rotation_y), -np.cos(rotation_y)])  # world x, y
    np.testing.assert_allclose(ahead, [0, 1], atol=1e-4)


def test_geojson_is_read_by_gis_libraries_and_lies_where_the_scene_does() -> None:
    here = replace(
        detection(),
        T_scene_model=yaw_matrix(90.0, np.array([323_000.0, 4_307_000.0, 0]))
        @ PLATE.T_object_model,
    )
    features = json.loads(geojson([here], MODELS, "EPSG:32615"))["features"]
    footprint: Any = shape(features[0]["geometry"])
    assert footprint.is_valid
    assert footprint.exterior.is_ccw  # RFC 7946
    to_utm = Transformer.from_crs("EPSG:4326", "EPSG:32615", always_xy=True)
    x, y = to_utm.transform(footprint.centroid.x, footprint.centroid.y)
    assert (x, y) == pytest.approx((323_000, 4_307_000), abs=0.01)
    area, _ = Geod(ellps="WGS84").geometry_area_perimeter(footprint)
    assert area == pytest.approx(2.0, rel=0.01)
    assert features[0]["properties"]["id"] == 0


def test_geojson_without_a_reference_system_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(StageError, match="coordinate reference system"):
        export(tmp_path, [detection()], "geojson")


def test_limits_stand_beside_the_values_that_they_are_for() -> None:
    rules = {"evidence": {"min_score": 0.8, "min_margin": 0.1}, "icp": {"max_rms_m": 0.01}}
    section = Verify.Config.model_validate(rules)
    tests = {t.what: t for t in limit_tests(detection(0, "rejected"), section)}
    assert tests["score"].passed is False
    assert "verify.evidence.min_score" in tests["score"].limit
    assert "rms m" not in tests  # of another method
    assert tests["heading margin"].passed is True


def test_results_appear_whole(finished_yard: YardRun) -> None:
    names = {path.name for path in finished_yard.output.iterdir()}
    assert {"detections.png", "report.html"} <= names
    assert "detections.geojson" not in names  # the scene does not say where it is
    assert not [name for name in names if name.endswith(".partial")]


def test_the_map_shows_the_accepted_in_their_colour(finished_yard: YardRun) -> None:
    pixels = np.asarray(Image.open(finished_yard.output / "detections.png").convert("RGB")) * 1
    assert (abs(pixels - ACCEPTED).max(axis=-1) < 12).sum() > 500


def test_las_tells_the_points_of_each_car(finished_yard: YardRun, tmp_path: Path, cli: Cli) -> None:
    path = tmp_path / "yard.las"
    assert cli("export", finished_yard.output, "-f", "las", "-o", path).code == 0
    las = laspy.read(path)
    accepted = {d["id"]: d for d in finished_yard.detections() if d["fate"] == "accepted"}
    assert set(np.unique(las["object_id"])) == {-1, *accepted}
    for number, d in accepted.items():
        own = las.xyz[las["object_id"] == number]
        assert len(own) > 300
        assert np.linalg.norm(own[:, :2].mean(axis=0) - d["position_scene"][:2]) < 0.5


@pytest.mark.parametrize("fates", ["accepted", "rejected,accepted"])
def test_export_takes_the_fates_that_are_asked_for(
    finished_yard: YardRun, tmp_path: Path, cli: Cli, fates: str
) -> None:
    path = tmp_path / "some.csv"
    assert cli("export", finished_yard.output, "-f", "csv", "--fate", fates, "-o", path).code == 0
    with path.open() as stream:
        written = [int(row["id"]) for row in csv.DictReader(stream)]
    assert written == [d["id"] for d in finished_yard.detections() if d["fate"] in fates.split(",")]
    outcome = cli("export", finished_yard.output, "-f", "csv", "--fate", "nonsense")
    assert outcome.code == 2
    assert "nonsense" in outcome.err


def test_why_tells_each_test_and_what_decided(
    finished_yard: YardRun, cli: Cli, tmp_path: Path
) -> None:
    for d in finished_yard.detections():
        outcome = cli("why", finished_yard.output, d["id"])
        assert outcome.code == 0, outcome.err
        assert f"candidate {d['id']}: {d['model']}, {d['fate']}" in outcome.out
        assert "correlation" in outcome.out
        assert f"--candidate {d['id']}" in " ".join(outcome.out.split())
        for part in d["parts"]:
            assert part in outcome.out
    first, second = (d["id"] for d in finished_yard.detections()[:2])
    picture = tmp_path / "why.png"
    outcome = cli("why", finished_yard.output, first, second, "--picture", picture)
    assert outcome.out.count("candidate ") >= 2
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB"))
    assert pixels.shape[0] * 3 == pixels.shape[1] * 2, "three squares side by side, two below"
    for strip in np.split(pixels, 2):
        for view in np.split(strip, 3, axis=1):
            assert len(np.unique(view.reshape(-1, 3), axis=0)) > 1, "something is drawn"
    outcome = cli("why", finished_yard.output, first, "--picture", picture)
    assert outcome.code == 1
    assert "--force" in outcome.err
    outcome = cli("why", finished_yard.output, first, "--picture", tmp_path / "why.txt")
    assert (outcome.code, outcome.err.count("\n")) == (1, 1)
    outcome = cli("why", finished_yard.output, "12345")
    assert outcome.code == 1
    assert "no candidate 12345" in outcome.err


def test_a_run_compared_with_itself_has_only_the_same(finished_yard: YardRun, cli: Cli) -> None:
    outcome = cli("diff", finished_yard.output, finished_yard.output)
    assert outcome.code == 0, outcome.err
    assert "0 gained, 0 lost, 0 moved, 0 changed type, 2 same" in outcome.out


def test_differences_of_two_runs() -> None:
    def at(number: int, x: float, model: str = "plate", turn: float = 0.0) -> Detection:
        place = (x, 0.0, 0.0)
        return replace(
            detection(number, model=model), position_scene=place, heading_deg=90.0 + turn
        )

    before = [at(0, 0), at(1, 10), at(2, 20), at(3, 30), at(4, 40)]
    after = [at(7, 0), at(8, 10.3), at(9, 20, "cloud"), at(10, 30, turn=180), at(11, 60)]
    found = {
        (d.kind, d.before and d.before.id, d.after and d.after.id) for d in compare(before, after)
    }
    assert found == {
        ("same", 0, 7), ("moved", 1, 8), ("changed type", 2, 9), ("moved", 3, 10),
        ("lost", 4, None), ("gained", None, 11),
    }  # fmt: skip


def test_status_tells_what_is_there(yard_run: YardRun, cli: Cli) -> None:
    outcome = cli("status", yard_run.output)
    assert outcome.code == 0, outcome.err
    assert outcome.out.count("complete") == 6
    assert "2 accepted" in outcome.out
    yard_run.mcap("verify").rename(yard_run.output / "06_verify.mcap.partial")
    outcome = cli("status", yard_run.output)
    assert outcome.out.count("complete") == 5
    assert "begun" in outcome.out
    assert "spinpipe run" in outcome.out


def test_what_a_killed_process_left_is_named_and_removed(yard_run: YardRun, cli: Cli) -> None:
    output = yard_run.output
    begun = output / "05_cluster.mcap.partial"
    left = {".scratch-x", "report.json.partial", ".spinpipe.partial", "run.rrd.partial"}
    (output / ".scratch-x").mkdir()
    (output / ".scratch-x" / "work").write_text("half")
    for name in (*left - {".scratch-x"}, begun.name, "mine.partial"):
        (output / name).write_text("half")
    out = cli("status", output).out
    assert all(name in out for name in (*left, begun.name))
    assert "mine.partial" not in out
    assert cli("run", yard_run.config, "--rerun", "off", "-o", output).code == 0
    assert not left & {path.name for path in output.iterdir()}
    assert (output / "mine.partial").exists()
    assert begun.exists()


def test_status_of_a_run_that_was_killed_in_its_first_stage(yard_run: YardRun, cli: Cli) -> None:
    for path in yard_run.output.iterdir():
        if path.name != ".spinpipe":
            path.unlink()
    (yard_run.output / "01_ingest.mcap.partial").write_text("half")
    outcome = cli("status", yard_run.output)
    assert outcome.code == 0, outcome.err
    assert "goes on from it: 01_ingest.mcap.partial" in outcome.out


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
