"""Models of objects: every format, frames, what is seen from above, and bad files."""

# trimesh and plyfile have no complete types
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from plyfile import PlyData, PlyElement
from pydantic import ValidationError

from spinpipe.schemas.records import ObjectModel
from spinpipe.stages.geometry.seen_from_above import FaceGrid, seen_from_above
from spinpipe.stages.geometry.shapes import Mesh, sample_surface
from spinpipe.stages.ingest.object_model import ModelConfig, object_model, read_model
from spinpipe.stages.stage import StageError


def load(path: Path, **options: Any) -> ObjectModel:
    fields = {"name": "thing", "path": path, "samples": 2000, **options}
    config = ModelConfig.model_validate(fields)
    return object_model(config, read_model(config), np.random.default_rng(0))


def box(low: tuple[float, ...], high: tuple[float, ...]) -> Any:
    return trimesh.creation.box(bounds=np.array([low, high], float))


@pytest.fixture
def brick() -> Any:
    """4 x 2 x 1, away from the origin."""
    return box((10, 20, 30), (14, 22, 31))


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb", ".off", ".gltf"])
def test_mesh_formats(tmp_path: Path, brick: Any, suffix: str) -> None:
    path = tmp_path / f"brick{suffix}"
    if suffix == ".gltf":
        files: Any = trimesh.Scene(brick).export(file_type="gltf")
        for name, content in files.items():
            (tmp_path / name).write_bytes(content)
        path = tmp_path / "model.gltf"
    else:
        brick.export(path)
    model = load(path, up="z", forward="x")
    assert model.points.shape == model.normals.shape == (2000, 3)
    assert model.points.dtype == model.normals.dtype == model.vertices.dtype == np.float32
    np.testing.assert_allclose(model.vertices.min(axis=0), (-2, -1, 0), atol=1e-5)
    np.testing.assert_allclose(model.vertices.max(axis=0), (2, 1, 1), atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(model.normals, axis=1), 1, atol=1e-5)
    # Uniform by area: top and bottom are 16 of 28 square metres
    assert np.mean(np.abs(model.normals[:, 2]) > 0.5) == pytest.approx(16 / 28, abs=0.04)
    corner = model.T_object_model @ (10, 20, 30, 1)
    np.testing.assert_allclose(corner, (-2, -1, 0, 1), atol=1e-9)


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
@pytest.mark.parametrize("forward", ["x", "y", "z", "-x", "-y", "-z"])
def test_axes_and_scale(tmp_path: Path, brick: Any, up: str, forward: str) -> None:
    path = tmp_path / "brick.stl"
    brick.export(path)
    if up[-1] == forward[-1]:
        with pytest.raises(ValidationError, match="set forward to another"):
            load(path, up=up, forward=forward)
        return
    model = load(path, up=up, forward=forward, scale=0.5)
    T = model.T_object_model
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, 0.25 * np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(0.125)
    for name, target in ((up, (0, 0, 0.5)), (forward, (0.5, 0, 0))):
        direction = np.zeros(3)
        direction["xyz".index(name[-1])] = -1 if name[0] == "-" else 1
        np.testing.assert_allclose(T[:3, :3] @ direction, target, atol=1e-12)
    low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
    np.testing.assert_allclose((low + high)[:2], 0, atol=1e-5)
    assert low[2] == pytest.approx(0, abs=1e-5)
    size = {"x": 4, "y": 2, "z": 1}
    np.testing.assert_allclose((high - low)[[0, 2]], [size[forward[-1]] / 2, size[up[-1]] / 2])


def test_up_in_any_direction(tmp_path: Path, brick: Any) -> None:
    """A brick that lies tilted in its file stands as it would untilted."""
    turn = trimesh.transformations.rotation_matrix(0.5, (1, 0, 0))
    brick.apply_transform(turn)
    brick.export(tmp_path / "brick.ply")
    model = load(tmp_path / "brick.ply", up=turn[:3, 2].tolist(), forward="x")
    np.testing.assert_allclose(model.size, (4, 2, 1), atol=1e-5)
    for up, forward in (([0, 0, 0], None), ([3, 0, 1e-9], "x")):
        with pytest.raises(ValidationError, match=r"up must not|set forward to another"):
            load(tmp_path / "brick.ply", up=up, forward=forward)


WEDGE = "v 0 -1 -2\nv 0 1 -2\nv 0 -1 2\nv 0 1 2\nv 1 0 -2\nv 1 0 1.8\n"
"""A roof on the plane x = 0, its ridge along z."""
SIDES = ("1 3 4 2", "1 5 6 3", "2 4 6 5", "1 2 5", "3 6 4")


@pytest.mark.parametrize(
    "text",
    [
        WEDGE + "".join(f"f {side}\n" for side in SIDES),
        "# Units: feet\n" + WEDGE + "".join(f"f {side}\n" for side in SIDES),
        WEDGE.replace(".", ",") + "".join(f"f {side}\n" for side in SIDES),
        WEDGE
        + "vt 0 0\nvn 0 0 1\n"
        + "".join(
            "f "
            + " ".join(f"{v}{('', '/1', '//1', '/1/1')[i]}" for i, v in enumerate(s.split()))
            + "\n"
            for s in SIDES
        ),
    ],
    ids=["x up", "unit in a comment", "decimal commas", "mixed corners"],
)
def test_dialects_of_obj(tmp_path: Path, text: str) -> None:
    (tmp_path / "roof.obj").write_text(text)
    config = ModelConfig(name="roof", path=tmp_path / "roof.obj")
    file = read_model(config)
    assert (file.up, file.forward, file.closed) == ("x", "z", True)
    assert "x is taken for up" in file.doubt
    assert file.metres == (0.3048 if "feet" in text else None)
    size = object_model(config, file, np.random.default_rng(0)).size
    np.testing.assert_allclose(size, np.array([4, 2, 1]) * (file.metres or 1), rtol=1e-6)


def test_parts_of_a_scene_keep_their_places(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for x in (0.0, 8.0):
        place = trimesh.transformations.translation_matrix((x, 0, 0))
        scene.add_geometry(box((0, 0, 0), (2, 1, 1)), transform=place)
    scene.export(tmp_path / "two.glb")
    model = load(tmp_path / "two.glb", up="z", forward="x")
    np.testing.assert_allclose(np.ptp(model.vertices, axis=0), (10, 1, 1), atol=1e-5)
    assert len(model.faces) == 24


def test_vertices_without_faces_do_not_move_the_base(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 2 0 0\nv 0 2 0\nv 50 50 -50\nf 1 2 3\n"
    (tmp_path / "triangle.obj").write_text(text)
    model = load(tmp_path / "triangle.obj")
    assert len(model.vertices) == 3
    np.testing.assert_allclose(model.T_object_model[:3, 3], (-1, -1, 0))


def table() -> Any:
    """A plate of 4 x 4 at 0.9 to 1.0 above a wider one of 6 x 6 at 0 to 0.1."""
    parts = [box((-2, -2, 0.9), (2, 2, 1)), box((-3, -3, 0), (3, 3, 0.1))]
    return trimesh.util.concatenate(parts)


def test_seen_from_above_is_the_upper_side_only(tmp_path: Path) -> None:
    table().export(tmp_path / "table.ply")
    model = load(tmp_path / "table.ply", visible_from="above", samples=3000)
    assert model.points.shape == (3000, 3)
    high = model.points[:, 2] > 0.5
    np.testing.assert_allclose(model.points[high][:, 2], 1, atol=1e-6)
    np.testing.assert_allclose(model.points[~high][:, 2], 0.1, atol=1e-6)
    # What shows of the lower plate is the rim outside the upper one
    assert (np.abs(model.points[~high][:, :2]).max(axis=1) > 2).all()
    assert high.mean() == pytest.approx(16 / 36, abs=0.03)


def test_seen_from_above_agrees_with_a_ray_for_each_point() -> None:
    rng = np.random.default_rng(3)
    triangles = rng.normal(0, 1, (200, 1, 3)) + rng.normal(0, 0.5, (200, 3, 3))
    vertices, faces = triangles.reshape(-1, 3), np.arange(600).reshape(-1, 3)
    points, _ = sample_surface(vertices, faces, 1500, rng)
    hidden = np.zeros(len(points), bool)
    for a, b, c in triangles:
        edges = np.column_stack([(b - a)[:2], (c - a)[:2]])
        v, w = np.linalg.solve(edges, (points - a)[:, :2].T)
        above = a[2] + v * (b - a)[2] + w * (c - a)[2] > points[:, 2] + 1e-5
        hidden |= (v >= 0) & (w >= 0) & (v + w <= 1) & above
    assert 0.1 < hidden.mean() < 0.9
    np.testing.assert_array_equal(
        seen_from_above(points, FaceGrid.of(Mesh(vertices, faces))), ~hidden
    )


def test_normals_seen_from_above_point_up_whatever_the_winding(tmp_path: Path) -> None:
    text = "v 0 0 0\nv 2 0 0\nv 0 2 0\nf 1 3 2\n"
    (tmp_path / "triangle.obj").write_text(text)
    options: dict[str, Any] = {"path": tmp_path / "triangle.obj"}
    np.testing.assert_array_equal(load(**options).normals[:, 2], -1)
    np.testing.assert_array_equal(load(**options, visible_from="above").normals[:, 2], 1)


def test_an_upright_wall_hides_nothing() -> None:
    vertices = np.array([(0, 0, 0), (2, 0, 0), (2, 0, 1), (0, 0, 1)], float)
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    points, _ = sample_surface(vertices, faces, 100, np.random.default_rng(0))
    assert seen_from_above(points, FaceGrid.of(Mesh(vertices, faces))).all()


def write_cloud(path: Path, xyz: Any) -> Path:
    rows = np.empty(len(xyz), [(axis, "f4") for axis in "xyz"])
    for i, axis in enumerate("xyz"):
        rows[axis] = np.asarray(xyz)[:, i]
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(path))
    return path


def test_cloud_model_keeps_all_its_points(tmp_path: Path) -> None:
    xyz = np.random.default_rng(0).random((500, 3)) * (4, 2, 1) + 100
    model = load(write_cloud(tmp_path / "cloud.ply", xyz), visible_from="above", up="z")
    assert len(model.points) == 500
    assert model.vertices.shape == model.faces.shape == (0, 3)
    assert not model.normals.any()
    np.testing.assert_allclose(np.ptp(model.points, axis=0), np.ptp(xyz, axis=0), rtol=1e-4)
    assert model.points[:, 2].min() == 0


def test_same_generator_same_samples(shared_data: Path) -> None:
    path = shared_data / "models" / "sedan.glb"
    options: dict[str, Any] = {"up": "y", "forward": "z", "visible_from": "above", "scale": 1.7}
    first, second = load(path, **options), load(path, **options)
    assert first.points.tobytes() == second.points.tobytes()
    length, width, height = np.ptp(first.vertices, axis=0)
    assert length == pytest.approx(2.55 * 1.7, rel=1e-3)
    assert width == pytest.approx(1.5 * 1.7, rel=1e-3)
    assert height == pytest.approx(1.3 * 1.7, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.obj", None, "no such file"),
        ("odd.docx", "Dear user", "of no known format"),
        ("empty.obj", "", "the file is empty"),
        ("points.obj", "v 0 0 0\nv 1 0 0\n", "neither faces nor enough points"),
        (
            "face.obj",
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
            r"refers to vertex \d of 3|cannot read",
        ),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "have no area"),
        ("nan.obj", "v 0 0 nan\nv 1 0 0\nv 2 1 0\nf 1 2 3\n", "not finite"),
        ("broken.glb", "glTF", "cannot read the mesh"),
        ("text.ply", "hello", "not a PLY file"),
    ],
)
def test_bad_models(tmp_path: Path, name: str, content: str | None, message: str) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(StageError, match=message) as caught:
        load(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_bad_cloud_models(tmp_path: Path) -> None:
    with pytest.raises(StageError, match="neither faces nor enough points"):
        load(write_cloud(tmp_path / "empty.ply", np.empty((0, 3))))
    with pytest.raises(StageError, match="neither faces nor enough points"):
        load(write_cloud(tmp_path / "nan.ply", np.full((10, 3), np.nan)))
    some = np.random.default_rng(0).normal(size=(60, 3))
    some[4, 1] = np.nan  # as Kinect clouds have them
    assert len(load(write_cloud(tmp_path / "some.ply", some)).points) == 59


@pytest.mark.parametrize("name", ["", "two words", "a/b", "ü"])
def test_names_must_be_plain(name: str) -> None:
    with pytest.raises(ValidationError, match="letters, digits"):
        ModelConfig(name=name, path=Path("model.obj"))
