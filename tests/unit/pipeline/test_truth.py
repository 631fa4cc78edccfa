"""Labels read from CSV files."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spinpipe.pipeline.evaluation.truth import read_truth
from spinpipe.schemas.records import SceneFrame, Upright
from spinpipe.stages.geometry.frames import transform, world_from_scene
from spinpipe.stages.stage import StageError


def frame(origin=(100.0, 200.0, 5.0), scale=1.0):
    return SceneFrame(
        origin, (scale, scale, scale), points=1, dropped=0, coloured=False, source="scene.ply"
    )


def upright(rotation=None, translation=(0.0, 0.0, 0.5)):
    rotation = Rotation.identity() if rotation is None else rotation
    return Upright(tuple(rotation.as_quat()), translation)


def read(tmp_path, text, *, frame=frame(), upright=upright(), coordinates="scene"):  # noqa: B008
    path = tmp_path / "truth.csv"
    path.write_text(text, encoding="utf-8")
    return read_truth(path, frame, upright, coordinates)


def test_all_columns(tmp_path):
    truth, ignored = read(
        tmp_path,
        "model,x,y,z,heading_deg,ignore\ncar,101,202,6,350,0\ncar,1,2,,,1\n",
    )
    assert truth.model == "car"
    assert truth.row == 2
    assert truth.position == pytest.approx((1.0, 2.0, 1.5))
    assert truth.heading_deg == pytest.approx(350.0)
    assert truth.axis_deg == pytest.approx(170.0)
    assert not truth.ignore
    assert ignored.ignore
    assert ignored.heading_deg is None
    assert math.isnan(ignored.position[2])


def test_only_places(tmp_path):
    (truth,) = read(tmp_path, "\ufeffx, y, note\n101, 202, by the wall\n")
    assert truth.position[:2] == pytest.approx((1.0, 2.0))
    assert truth.model == ""
    assert truth.axis_deg is None


def test_place_without_height_is_on_the_ground_of_a_tilted_scene(tmp_path):
    tilted = upright(Rotation.from_euler("xyz", [3, -4, 20], degrees=True))
    T = world_from_scene(frame(), tilted)
    on_ground = transform(np.linalg.inv(T), np.array([[7.0, -8.0, 0.0]]))[0]
    text = f"x,y,heading_deg\n{on_ground[0]},{on_ground[1]},10\n"
    (truth,) = read(tmp_path, text, upright=tilted)
    assert truth.position[:2] == pytest.approx((7.0, -8.0), abs=1e-9)
    assert truth.heading_deg == pytest.approx(30.0, abs=0.5)


def test_scale_applies_to_places(tmp_path):
    (truth,) = read(tmp_path, "x,y,z\n101,202,5\n", frame=frame(scale=2.0))
    assert truth.position == pytest.approx((2.0, 4.0, 0.5))


def test_world_coordinates_stay(tmp_path):
    lying = upright(Rotation.from_euler("x", 90, degrees=True))
    (truth,) = read(tmp_path, "x,y,axis_deg\n1,2,200\n", upright=lying, coordinates="world")
    assert truth.position[:2] == (1.0, 2.0)
    assert truth.axis_deg == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("model,x\ncar,1\n", "no column 'y'"),
        ("", "no column 'x'"),
        ("x,y,heading\n1,2,3\n", "unknown column 'heading'; rename it: 'heading_deg'"),
        ("x,y\n1,two\n", "line 2: y = 'two' is no number"),
        ("x,y\n1,nan\n", "line 2: y = 'nan' is no number"),
        ("x,y\n1,\n", "line 2: x or y is empty"),
    ],
)
def test_errors_name_line_and_column(tmp_path, text, says):
    with pytest.raises(StageError, match=says) as error:
        read(tmp_path, text)
    assert "\n" not in str(error.value)


def test_scene_on_its_side_needs_world_coordinates(tmp_path):
    lying = upright(Rotation.from_euler("x", 90, degrees=True))
    with pytest.raises(StageError, match="--frame world"):
        read(tmp_path, "x,y\n1,2\n", upright=lying)
    (truth,) = read(tmp_path, "x,y,z\n101,202,6\n", upright=lying)
    assert truth.position == pytest.approx((1.0, -1.0, 2.5))
