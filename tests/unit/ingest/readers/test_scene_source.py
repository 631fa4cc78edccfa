"""Readers of scenes: every flavour of PLY, LAS, COLMAP; good files, bad files, real files."""

# plyfile, laspy and pycolmap have no complete types
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plyfile import PlyData, PlyElement

from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.ingest.readers.scene_source import (
    About,
    Chunk,
    MemorySource,
    SceneSource,
    held,
)
from spinpipe.stages.stage import StageError

COLOUR_NAMES = [
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
]


def cloud(count: int, seed: int = 0) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    rng = np.random.default_rng(seed)
    xyz = rng.normal(0, 100, (count, 3)).astype(np.float32)
    return xyz.astype(np.float64), rng.integers(0, 256, (count, 3)).astype(np.uint8)


def read(source: SceneSource, chunk: int = 1000) -> tuple[Any, Any]:
    pieces = list(source.chunks(chunk))
    assert all(len(xyz) <= chunk and len(xyz) == len(rgb) for xyz, rgb in pieces)
    xyz = np.concatenate([np.empty((0, 3)), *(xyz for xyz, _ in pieces)])
    rgb = np.concatenate([np.empty((0, 3), np.uint8), *(rgb for _, rgb in pieces)])
    assert xyz.dtype == np.float64
    assert rgb.dtype == np.uint8
    assert len(xyz) == source.points
    return xyz, rgb


def vertices(xyz: Any, columns: list[tuple[str, str, Any]], number: str = "f4") -> PlyElement:
    rows = np.empty(len(xyz), [(axis, number) for axis in "xyz"] + [(n, t) for n, t, _ in columns])
    for i, axis in enumerate("xyz"):
        rows[axis] = xyz[:, i]
    for name, _, values in columns:
        rows[name] = values
    return PlyElement.describe(rows, "vertex")


@given(
    count=st.integers(0, 60),
    chunk=st.integers(1, 70),
    number=st.sampled_from(["f4", "f8"]),
    encoding=st.sampled_from(["ascii", "<", ">"]),
    names=st.sampled_from(COLOUR_NAMES),
    kind=st.sampled_from(["none", "u1", "u2", "unit float", "float"]),
    extra=st.booleans(),
    before=st.booleans(),
)
@settings(deadline=None)
def test_ply_flavours_round_trip(
    tmp_path_factory: pytest.TempPathFactory,
    count: int,
    chunk: int,
    number: str,
    encoding: str,
    names: tuple[str, str, str],
    kind: str,
    extra: bool,
    before: bool,
) -> None:
    xyz, rgb = cloud(count)
    if count and kind != "none":
        rgb[0] = 255  # so that the range of the colours shows
    columns: list[tuple[str, str, Any]] = []
    if extra:
        columns += [("nx", "f4", 1.5), ("quality", "f8", 0.25)]
    if kind != "none":
        written, ply_type = {
            "u1": (rgb, "u1"),
            "u2": (rgb.astype(np.uint16) * 257, "u2"),
            "unit float": (rgb / np.float32(255), "f4"),
            "float": (rgb.astype(np.float32), "f4"),
        }[kind]
        columns += [(name, ply_type, written[:, i]) for i, name in enumerate(names)]
    elements = [vertices(xyz, columns, number)]
    if before:
        camera = np.array([(1.0, 7)], [("focal", "f4"), ("id", "i4")])
        elements.insert(0, PlyElement.describe(camera, "camera"))
    path = tmp_path_factory.mktemp("ply") / "cloud.ply"
    text = encoding == "ascii"
    PlyData(elements, text=text, byte_order="=" if text else encoding).write(str(path))

    source = open_scene(path)
    found_xyz, found_rgb = read(source, chunk)

    assert source.coloured == (kind != "none")
    assert source.about.cameras is None
    np.testing.assert_allclose(found_xyz, xyz, rtol=1e-6 if text else 0)
    np.testing.assert_array_equal(found_rgb, rgb if kind != "none" else np.full_like(rgb, 255))


@pytest.mark.parametrize("encoding", ["<", ">"])
@pytest.mark.parametrize("position", ["before x", "after z"])
def test_binary_ply_with_lists_in_its_rows(tmp_path: Path, encoding: str, position: str) -> None:
    xyz, rgb = cloud(500)
    views = "property list ushort uint views"
    scalars = [f"property float {axis}" for axis in "xyz"]
    scalars.insert(0 if position == "before x" else 3, views)
    header = [
        "ply",
        f"format binary_{'little' if encoding == '<' else 'big'}_endian 1.0",
        "element face 3",
        "property list uchar int vertex_indices",
        "element vertex 500",
        *scalars,
        *(f"property uchar {name}" for name in COLOUR_NAMES[0]),
        "end_header",
        "",
    ]
    body = [struct.pack(f"{encoding}B{n}i", n, *range(n)) for n in (3, 4, 3)]
    for i in range(500):
        seen = struct.pack(f"{encoding}H{i % 5}I", i % 5, *range(i % 5))
        place = struct.pack(f"{encoding}3f", *xyz[i])
        row = seen + place if position == "before x" else place + seen
        body.append(row + rgb[i].tobytes())
    path = tmp_path / "openmvs.ply"
    path.write_bytes("\n".join(header).encode() + b"".join(body))

    found_xyz, found_rgb = read(open_scene(path), 77)
    np.testing.assert_array_equal(found_xyz, xyz)
    np.testing.assert_array_equal(found_rgb, rgb)

    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(StageError, match=r"cut short, [123] of 500 points are missing"):
        read(open_scene(path), 77)


@pytest.mark.parametrize("line_end", [b"\n", b"\r\n", b"\r"])
def test_header_line_ends_and_odd_comments(tmp_path: Path, line_end: bytes) -> None:
    lines = [
        b"ply",
        b"format binary_little_endian 1.0",
        "comment généré par Résumé".encode("latin-1"),
        b"element vertex 2",
        b"property double x",
        b"property double y",
        b"property double z",
        b"end_header",
    ]
    # 10 is '\n': a reader that guesses the line end would swallow the first byte
    values = np.frombuffer(bytes([10]) * 8 + bytes(40), "<f8")
    path = tmp_path / "cloud.ply"
    path.write_bytes(line_end.join([*lines, b""]) + values.tobytes())
    np.testing.assert_array_equal(read(open_scene(path))[0], values.reshape(2, 3))


def write_ply(path: Path, count: int = 100, **options: Any) -> Path:
    PlyData([vertices(cloud(count)[0], [])], **options).write(str(path))
    return path


def test_binary_ply_cut_short(tmp_path: Path) -> None:
    path = write_ply(tmp_path / "cloud.ply", byte_order="<")
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(StageError, match="cut short, 30 bytes or 3 of 100 points are missing"):
        open_scene(path)


def test_ascii_ply_cut_short(tmp_path: Path) -> None:
    path = write_ply(tmp_path / "cloud.ply", text=True)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-4]))
    with pytest.raises(StageError, match="cut short, 4 of 100 points are missing"):
        read(open_scene(path), 30)
    path.write_bytes(b"".join(lines[:-1]) + lines[-1].split()[0])
    with pytest.raises(StageError, match="cannot read points 90 to 100 of 100"):
        read(open_scene(path), 30)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not a PLY file"),
        (b"plywood", "not a PLY file"),
        (b"ply\nformat ascii 1.0\nelement vertex 3\n", "no 'end_header'"),
        (b"ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "broken PLY header"),
        (b"ply\nformat ascii 1.0\nproperty float x\nend_header\n", "broken PLY header"),
        (b"ply\nformat ascii 1.0\nelement face 0\nend_header\n", "no element 'vertex'"),
        (
            b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n"
            b"end_header\n",
            r"no property z \(only x, y\)",
        ),
    ],
)
def test_broken_ply_headers(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(content)
    with pytest.raises(StageError, match=message) as caught:
        open_scene(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_las_colours_of_8_and_16_bits(tmp_path: Path) -> None:
    import laspy

    xyz, rgb = cloud(300)
    rgb[7] = 255
    for factor, name in ((1, "eight.las"), (257, "sixteen.laz")):
        las: Any = laspy.create(point_format=3, file_version="1.2")
        las.header.offsets, las.header.scales = [0, 0, 0], [0.001] * 3
        las.x, las.y, las.z = xyz.T
        las.red, las.green, las.blue = (rgb.astype(np.uint16) * factor).T
        las.write(tmp_path / name)
        found_xyz, found_rgb = read(open_scene(tmp_path / name), 100)
        np.testing.assert_allclose(found_xyz, xyz, atol=0.00051)
        np.testing.assert_array_equal(found_rgb, rgb)


def test_las_cut_short(tmp_path: Path, shared_data: Path) -> None:
    for name in ("simple.las", "autzen_trim.laz"):
        whole = (shared_data / "formats" / "laspy_las" / name).read_bytes()
        path = tmp_path / name
        path.write_bytes(whole[: len(whole) * 2 // 3])
        with pytest.raises(StageError, match="cut short"):
            read(open_scene(path))
        path.write_bytes(whole[:50])
        with pytest.raises(StageError, match="cannot read the LAS file"):
            open_scene(path)


@pytest.mark.parametrize(("memory", "reads"), [(27 * 500, 1), (27 * 499, 2)])
def test_what_fits_into_memory_is_read_once(memory: int, reads: int) -> None:
    class Counted(MemorySource):
        opened = 0

        def chunks(self, points: int) -> Iterator[Chunk]:
            Counted.opened += 1
            return super().chunks(points)

    xyz, rgb = cloud(500)
    source = held(Counted(About("cloud"), xyz, rgb), memory)
    next(iter(source.chunks(100)))  # one that stops early has not seen it all
    Counted.opened = 0
    for _ in range(2):
        again = read(source, 100)
        np.testing.assert_array_equal(again[0], xyz)
        np.testing.assert_array_equal(again[1], rgb)
    assert Counted.opened == reads


def test_paths_that_are_no_scene(tmp_path: Path) -> None:
    with pytest.raises(StageError, match="no such file or folder"):
        open_scene(tmp_path / "nothing.ply")
    with pytest.raises(StageError, match="no COLMAP model"):
        open_scene(tmp_path)
    (tmp_path / "cloud.xyz").touch()
    with pytest.raises(StageError, match="the file is empty"):
        open_scene(tmp_path / "cloud.xyz")


def test_colmap_folder_above_the_model_and_broken_model(tmp_path: Path) -> None:
    model = tmp_path / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "points3D.bin").write_bytes(b"\0\0")
    with pytest.raises(StageError, match="give the folder 'sparse/0' below it"):
        open_scene(tmp_path)
    with pytest.raises(StageError, match="cannot read the COLMAP model"):
        open_scene(model)


def test_colmap_model_binary_and_text(shared_data: Path, tmp_path: Path) -> None:
    import pycolmap

    folder = shared_data / "brighton" / "colmap_sparse"
    binary = open_scene(folder)
    pycolmap.Reconstruction(folder).write_text(tmp_path)
    text = open_scene(tmp_path)
    assert binary.points == text.points == 6847
    for ours, theirs in zip(read(binary), read(text), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
    assert binary.about.cameras is not None
    assert text.about.cameras is not None
    positions, quaternions = binary.about.cameras.positions, binary.about.cameras.quaternions_xyzw
    np.testing.assert_allclose(text.about.cameras.positions, positions, atol=1e-9)
    assert positions.shape == (18, 3)
    # The photos look down from 46 m: the cameras' +z axis points down in the scene
    np.testing.assert_allclose(positions[:, 2], 46, atol=3)
    x, y, *_ = quaternions.T
    assert (1 - 2 * (x * x + y * y) < -0.95).all()


def test_colmap_model_without_points(shared_data: Path, tmp_path: Path) -> None:
    import pycolmap

    model = pycolmap.Reconstruction(shared_data / "brighton" / "colmap_sparse")
    for key in list(model.points3D):
        model.delete_point3D(key)
    model.write(tmp_path)
    with pytest.raises(StageError, match="has no points"):
        open_scene(tmp_path)


@pytest.mark.parametrize(
    ("name", "points", "coloured"),
    [
        ("photo-west/scene.ply", 222_508, True),
        ("brighton/pmvs/option-first30000.ply", 30_000, True),
        ("formats/colmap_fused_crlf/fused.ply", 110_106, True),
        ("formats/colmap_fused_crlf/sparse.ply", 1708, True),
        ("formats/colmap_fused_vis/fused.ply", 924, True),
        ("formats/openmvs/Sparse.ply", 12_683, True),
        ("formats/openmvs/scene_mesh.ply", 1_000_000, False),
        ("formats/pmvs_bundler_kermit/option-0000.ply", 10_003, True),
        ("formats/pmvs_bundler_kermit/points010.ply", 1023, True),
        ("formats/laspy_las/autzen_trim.laz", 110_000, True),
        ("formats/laspy_las/simple.copc.laz", 1065, True),
        ("formats/laspy_las/simple1_4.las", 22_600, True),
        ("formats/odm_laz/test.laz", 269_915, True),
        ("formats/colmap_old_bin/sparse/0", 699, True),
    ],
)
def test_real_files(shared_data: Path, name: str, points: int, coloured: bool) -> None:
    source = open_scene(shared_data / name)
    xyz, rgb = read(source, 50_000)
    assert (source.points, source.coloured) == (points, coloured)
    assert np.isfinite(xyz).all()
    assert 190 <= rgb.max() <= 255
    assert (rgb.min() < 100) == coloured
