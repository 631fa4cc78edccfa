"""Formats told by content: bytes made to the published formats, and files that others wrote."""

# laspy, pycolmap and trimesh have no complete types
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from tests.unit.ingest.readers.small_cloud import RGB, ROWS, XYZ, read

from spinpipe.stages.ingest.model_file import open_model
from spinpipe.stages.ingest.object_model import ModelConfig, object_model
from spinpipe.stages.ingest.readers.mesh import read_mesh
from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.stage import StageError


def lzf(data: bytes) -> bytes:
    """LZF that only copies: runs of up to 32 bytes, and one reference back to show them."""
    runs = [data[i : i + 32] for i in range(0, len(data), 32)]
    return b"".join(bytes([len(run) - 1]) + run for run in runs)


def pcd(encoding: str) -> bytes:
    packed = (RGB.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)).astype("<u4")
    rows = np.zeros(4, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("n", "<f4", 2), ("rgb", "<f4")])
    for i, axis in enumerate("xyz"):
        rows[axis] = XYZ[:, i]
    rows["rgb"] = packed.view("<f4")
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z n rgb\n"
        "SIZE 4 4 4 4 4\nTYPE F F F F F\nCOUNT 1 1 1 2 1\nWIDTH 2\nHEIGHT 2\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA {encoding}\n"
    ).encode()
    if encoding == "binary":
        return head + rows.tobytes()
    if encoding == "binary_compressed":
        columns = b"".join(rows[name].tobytes() for name in rows.dtype.names or ())
        squeezed = lzf(columns)
        return head + struct.pack("<II", len(squeezed), len(columns)) + squeezed
    lines = [
        f"{x:.9g} {y:.9g} {z:.9g} 0 0 {c:.9g}"
        for (x, y, z), c in zip(XYZ, rows["rgb"], strict=True)
    ]
    return head + "\n".join(lines).encode() + b"\n"


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
def test_pcd(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "cloud.dat"  # the suffix does not tell
    whole = pcd(encoding)
    path.write_bytes(whole)
    xyz, rgb = read(path)
    np.testing.assert_allclose(xyz, XYZ, rtol=1e-6)
    np.testing.assert_array_equal(rgb, RGB)
    for cut in range(len(whole) - (20 if encoding == "ascii" else 1), 0, -23):
        path.write_bytes(whole[:cut])
        with pytest.raises(StageError) as caught:
            read(path)
        assert "\n" not in str(caught.value)


def test_pcd_references_back(tmp_path: Path) -> None:
    from spinpipe.stages.ingest.readers.pcd import unpack_lzf

    squeezed = np.frombuffer(bytes([2]) + b"abc" + bytes([(4 - 2) << 5, 2]), np.uint8)
    unpacked = unpack_lzf(squeezed, 7)
    assert unpacked is not None
    assert unpacked.tobytes() == b"abcabca"
    assert unpack_lzf(squeezed, 6) is None
    assert unpack_lzf(squeezed[:-1], 7) is None
    assert unpack_lzf(np.frombuffer(bytes([1 << 5, 9]), np.uint8), 3) is None


@pytest.mark.parametrize("name", ["milk/milk.pcd", "mosd/test0.pcd"])
def test_pcd_of_others(shared_data: Path, name: str) -> None:
    xyz, _ = read(shared_data / name, 10_000)
    finite = xyz[np.isfinite(xyz).all(axis=1)]
    assert len(finite) > 10_000
    assert np.ptp(finite, axis=0).max() < 10


def test_a_count_that_is_too_small_is_said(tmp_path: Path) -> None:
    (tmp_path / "cloud.pts").write_text("2\n" + ROWS)
    assert open_scene(tmp_path / "cloud.pts").about.notes == (
        "its header says 2 points, 4 are there",
    )
    whole = pcd("binary")
    fewer = whole.replace(b"POINTS 4", b"POINTS 2").replace(b"HEIGHT 2", b"HEIGHT 1")
    (tmp_path / "cloud.pcd").write_bytes(fewer)
    (note,) = open_scene(tmp_path / "cloud.pcd").about.notes
    assert note.startswith(
        "odd: its header says 2 points, what follows them has the size of 2 more"
    )


def test_data_of_another_kind_than_the_header_says(tmp_path: Path) -> None:
    path = tmp_path / "cloud"
    text, binary = pcd("ascii"), pcd("binary")
    swapped = text.replace(b"DATA ascii", b"DATA binary"), binary.replace(b"binary", b"ascii")
    head = f"ply\nformat {{}} 1.0\nelement vertex 4\n{AXES}end_header\n"
    swapped += (
        (head.format("binary_little_endian") + ROWS).encode(),
        (head.format("ascii").encode() + XYZ.astype("<f4").tobytes()),
    )
    for content in swapped:
        path.write_bytes(content)
        with pytest.raises(StageError, match=r"its header says (ascii|binary), but its data are"):
            open_scene(path)
    values = np.frombuffer(b"\n\x80" * 120, "<f4")
    binary = head.format("binary_little_endian").replace("4", "20", 1).encode() + values.tobytes()
    path.write_bytes(binary)
    assert open_scene(path).points == 20
    path.write_bytes(binary.replace(b"\n", b"\r\n"))
    with pytest.raises(StageError, match="line ends were translated"):
        open_scene(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"PK\x03\x04 and more", "zip archive; unpack"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0", "Git LFS pointer"),
        (b"<!DOCTYPE html><html>", "a web page"),
        (b"MVSI\x07\0\0\0", "OpenMVS project; give the PLY"),
        (b"\0\x01\x02" * 50, "of no known format"),
        (b"once upon a time\nthere was a cloud\n", "of no known format"),
        (b"\0" * 100, "the file is empty"),
        (b"4\n1\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "a PTX file"),
        ("x,y,z\n1,2,3\n".encode("utf-16"), "text in UTF-16; save it as UTF-8"),
        (b"ncols 2\nnrows 1\n1 2\n", "a raster of heights"),
        (b"  0\r\nSECTION\r\n  2\r\nENTITIES\r\n", "a DXF drawing"),
        (b"999\nmade by\n0\nSECTION\n2\nHEADER\n", "a DXF drawing"),
        (b"AC1032\0\0", "a DWG drawing"),
        (b'{"camera_angle_x": 1, "frames": [{"transform_matrix": []}]}', "a NeRF dataset"),
        (b"500.123,250;4.482.130,000;650,1\n500.124,250;4.482.131,000;650,2\n", "thousands"),
        (b"500,123.25 4,482,130.0 650.1\n500,124.25 4,482,131.0 650.2\n", "thousands"),
        (b"; FBX 7.3.0 project file\n", "an FBX file"),
        (b" " * 72 + b"S      1\n", "an IGES file"),
    ],
)
def test_files_that_are_no_cloud(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "scene.dat").write_bytes(content)
    with pytest.raises(StageError, match=message):
        open_scene(tmp_path / "scene.dat")


AXES = "property float x\nproperty float y\nproperty float z\n"


def ply(properties: list[str], rows: list[str], extra: str = "", after: str = "") -> bytes:
    head = [f"ply\nformat ascii 1.0\nelement vertex {len(rows)}", *properties]
    return ("\n".join(head) + extra + "\nend_header\n" + "\n".join(rows) + "\n" + after).encode()


def test_ply_names_in_capitals_lists_and_decimal_commas(tmp_path: Path) -> None:
    properties = ["property uchar Blue", "property list uchar int seen", "property double Z"]
    properties += ["property double X", "property double Y", "property uchar Red"]
    properties += ["property uchar Green"]
    rows = [
        f"{b} {i} {' '.join('7' * i)} {z} {x} {y} {r} {g}".replace(".", ",")
        for i, ((x, y, z), (r, g, b)) in enumerate(zip(XYZ, RGB, strict=True))
    ]
    path = tmp_path / "cloud.ply"
    path.write_bytes(ply(properties, rows))
    xyz, rgb = read(path)
    np.testing.assert_allclose(xyz, XYZ)
    np.testing.assert_array_equal(rgb, RGB)


@pytest.mark.parametrize("order", ["<", ">"])
def test_ply_strips_are_unwound(tmp_path: Path, order: str) -> None:
    corners = [(0, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0), (2, 0, 0), (5, 0, 0), (6, 0, 0)]
    corners.append((5, 1, 0))
    strip = [0, 1, 2, 3, 4, -1, 5, 6, 7]
    head = (
        f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0\n"
        f"element vertex {len(corners)}\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    data = np.array(corners, order + "f4").tobytes()
    path = tmp_path / "strip.ply"
    path.write_bytes(head.encode() + data + struct.pack(f"{order}10i", len(strip), *strip))
    mesh = read_mesh(path, "ply")
    assert mesh is not None
    assert mesh.faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4], [5, 6, 7]]
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(StageError, match="cut short, 1 of 1 faces"):
        read_mesh(path, "ply")


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_polygons_agree_with_trimesh(tmp_path: Path, encoding: str) -> None:
    sphere: Any = trimesh.creation.icosphere(2)
    path = tmp_path / "sphere.ply"
    sphere.export(path, encoding=encoding)
    mesh = read_mesh(path, "ply")
    assert mesh is not None
    np.testing.assert_array_equal(mesh.faces, sphere.faces)
    np.testing.assert_allclose(mesh.vertices, sphere.vertices, atol=1e-6)
    assert open_model(path, None, None).closed


def test_a_million_faces_are_no_attack(tmp_path: Path) -> None:
    """STL repeats every corner; its library takes nine times the file's size for a while."""
    faces = np.zeros(
        1_600_000, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("_", "<u2")])
    )
    faces["corners"] = np.random.default_rng(0).random((len(faces), 3, 3), np.float32)
    path = tmp_path / "large.stl"
    path.write_bytes(bytes(80) + np.uint32(len(faces)).tobytes() + faces.tobytes())
    mesh = read_mesh(path, "stl")
    assert mesh is not None
    assert len(mesh.faces) == len(faces)


def test_a_mesh_as_a_scene_is_sampled_and_said(tmp_path: Path) -> None:
    box: Any = trimesh.creation.box(extents=(4, 2, 1))
    box.visual.vertex_colors = np.tile([[10, 20, 30, 255]], (8, 1))
    for suffix in (".ply", ".obj", ".glb", ".off", ".stl"):
        box.export(tmp_path / f"box{suffix}")
        source = open_scene(tmp_path / f"box{suffix}")
        assert "points drawn from its 12 faces" in source.about.notes[0]
        xyz, rgb = next(iter(source.chunks(50_000)))
        on_face = np.isclose(np.abs(xyz), [2, 1, 0.5], atol=1e-6).any(axis=1)
        assert on_face.all()
        assert source.about.up == ((0, 1, 0) if suffix == ".glb" else None)
        if suffix == ".ply":
            np.testing.assert_array_equal(rgb[0], [10, 20, 30])


def test_vertices_of_obj_files(tmp_path: Path) -> None:
    lines = [f"v {x} {y} {z} {r / 255} {g / 255} {b / 255}" for (x, y, z), (r, g, b) in
             zip(XYZ, RGB, strict=True)]  # fmt: skip
    (tmp_path / "cloud.obj").write_text("# vertices\nmtllib no.mtl\n" + "\n".join(lines) + "\n")
    xyz, rgb = read(tmp_path / "cloud.obj")
    np.testing.assert_allclose(xyz, XYZ)
    np.testing.assert_array_equal(rgb, RGB)


@pytest.mark.parametrize("axis", ["Y", "Z"])
def test_dae_says_its_unit_and_which_axis_is_up(tmp_path: Path, axis: str) -> None:
    path = tmp_path / "box.dae"
    trimesh.creation.box(bounds=[(0, 0, 0), (400, 200, 100)]).export(path)
    text = path.read_text()
    asset = f'<unit name="cm" meter="0.01"/>\n<up_axis>{axis}_UP</up_axis>\n</asset>'
    path.write_text(re.sub(r"<unit.*?/>\s*|<up_axis>.*?</up_axis>\s*", "", text, flags=re.S)
                    .replace("</asset>", asset))  # fmt: skip
    model = open_model(path, None, None)
    assert (model.up, model.metres) == (axis.lower(), 0.01)
    assert model.reason == "as the DAE file says"
    assert model.closed
    for scale, length_m in ((None, 4.0), (0.1, 40.0)):
        config = ModelConfig(name="box", path=path, scale=scale)
        built = object_model(config, model, np.random.default_rng(0))
        assert built.size[0] == pytest.approx(length_m)


@pytest.mark.parametrize(
    ("accessor", "used", "message"),
    [
        ({"sparse": {}}, [], "sparse accessors; export it without"),
        ({}, ["EXT_meshopt_compression"], "compressed with meshopt; export it without"),
    ],
)
def test_gltf_that_would_be_read_wrongly(
    tmp_path: Path, accessor: dict[str, Any], used: list[str], message: str
) -> None:
    path = tmp_path / "box.gltf"
    trimesh.creation.box().export(path)
    document = json.loads(path.read_text())
    document["accessors"] = [item | accessor for item in document["accessors"]]
    path.write_text(json.dumps(document | {"extensionsRequired": used}))
    with pytest.raises(StageError, match=message):
        read_mesh(path, "gltf")


def test_las_whose_header_says_no_points(tmp_path: Path, shared_data: Path) -> None:
    whole = (shared_data / "formats" / "laspy_las" / "simple.las").read_bytes()
    expected, _ = read(shared_data / "formats" / "laspy_las" / "simple.las", 500)
    path = tmp_path / "pipe.las"
    path.write_bytes(whole[:107] + bytes(24) + whole[131:])
    source = open_scene(path)
    np.testing.assert_array_equal(np.concatenate([p for p, _ in source.chunks(500)]), expected)
    assert "says 0 points, 1,065 are there" in source.about.notes[0]


def test_las_that_claims_billions_of_records(shared_cases: Path) -> None:
    with pytest.raises(StageError, match=r"claims 4,2\d\d,\d{3},\d{3} records"):
        open_scene(shared_cases / "hostile" / "min_hang_vlrs.las")


def test_bundler_and_opensfm(shared_data: Path) -> None:
    bundler = open_scene(shared_data / "brighton" / "pmvs" / "bundle.rd.out")
    colmap = open_scene(shared_data / "brighton" / "colmap_sparse")
    assert bundler.about.cameras is not None
    assert colmap.about.cameras is not None
    # The same photos, placed alike by the file that COLMAP exported
    places = [s.about.cameras.positions for s in (bundler, colmap)]
    apart = np.linalg.norm(places[0][:, None] - places[1][None], axis=2).min(axis=1)
    assert np.median(apart) < 0.01
    forward = bundler.about.cameras.quaternions_xyzw
    x, y = forward[:, 0], forward[:, 1]
    assert (1 - 2 * (x * x + y * y) < -0.95).all()  # the photos look down

    kermit = open_scene(shared_data / "formats" / "pmvs_bundler_kermit" / "bundle.out")
    assert kermit.points > 500
    berlin = open_scene(shared_data / "formats" / "opensfm" / "reconstruction_example.json")
    assert berlin.points > 1000
    assert berlin.about.cameras is not None


def test_pmvs_patches(tmp_path: Path) -> None:
    patches = "".join(
        f"PATCHS\n{x} {y} {z} 1\n0 0 1 0\n0.9 1 1\n2\n0 1\n0\n\n\n" for x, y, z in XYZ
    )
    path = tmp_path / "option-0000.patch"
    path.write_text(f"PATCHES\n{len(XYZ)}\n{patches}")
    xyz, _ = read(path)
    np.testing.assert_allclose(xyz, XYZ)
    path.write_text(f"PATCHES\n{len(XYZ) + 1}\n{patches}")
    with pytest.raises(StageError, match="cannot read the PMVS patch file"):
        read(path)
