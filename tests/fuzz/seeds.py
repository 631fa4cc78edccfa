"""One small whole file of every format that spinpipe reads, to be damaged by the fuzzers."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import trimesh
from plyfile import PlyData, PlyElement

from spinpipe.pipeline.config import load_config
from spinpipe.pipeline.evaluation.truth import read_truth
from spinpipe.pipeline.mcap_file import Messages, StageFileWriter, read_metadata
from spinpipe.schemas import CLOUD
from spinpipe.schemas.records import CloudTile, SceneFrame, Upright
from spinpipe.stages.ingest.object_model import ModelConfig, object_model, read_model
from spinpipe.stages.ingest.readers.open_scene import open_scene

POINTS = np.random.default_rng(0).uniform(-5, 5, (60, 3))

CONFIG = """\
[ingest]
scene = "scene.ply"
scale = 1.5
[[model]]
name = "saloon"
path = "saloon.ply"
[ground]
up = [0, 0.1, 1]
[scan]
radius_m = 2.5
bin_m = 0.2
"""
PCD = """\
VERSION 0.7
FIELDS x y z rgb
SIZE 4 4 4 4
TYPE F F F U
COUNT 1 1 1 1
WIDTH 60
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 60
DATA {kind}
"""


def ply(path: Path, text: bool) -> None:
    rows = np.zeros(
        len(POINTS), [(a, "f4") for a in "xyz"] + [(c, "u1") for c in ("red", "green", "blue")]
    )
    for i, axis in enumerate("xyz"):
        rows[axis] = POINTS[:, i]
    PlyData([PlyElement.describe(rows, "vertex")], text=text).write(str(path))


def las(path: Path) -> None:
    cloud = laspy.create(point_format=3, file_version="1.2")
    cloud.header.scales, cloud.header.offsets = np.full(3, 0.001), np.zeros(3)
    cloud.xyz = POINTS
    cloud.red = np.arange(len(POINTS), dtype=np.uint16)
    cloud.write(str(path))


def colmap_points(path: Path) -> None:
    data = struct.pack("<Q", len(POINTS))
    for i, (x, y, z) in enumerate(POINTS.tolist()):
        data += struct.pack("<Q3d3BdQ", i, x, y, z, 9, 8, 7, 0.5, 2) + struct.pack(
            "<4I", 1, i, 2, i
        )
    path.write_bytes(data)


def colmap_images(path: Path) -> None:
    """With the points and the camera beside it."""
    colmap_points(path.with_name("points3D.bin"))
    path.with_name("cameras.bin").write_bytes(
        struct.pack("<QIiQQ4d", 1, 1, 1, 64, 48, 50, 50, 32, 24)
    )
    data = struct.pack("<Q", 2)
    for key in (1, 2):
        data += struct.pack("<I7dI", key, 1, 0, 0, 0, 0.1, 0.2, key, 1) + b"a.jpg\0"
        data += struct.pack("<Q", 1) + struct.pack("<2dQ", 3, 4, 0)
    path.write_bytes(data)


def colmap_text(path: Path) -> None:
    lines = [f"{i} {x} {y} {z} 9 8 7 0.5 1 {i}" for i, (x, y, z) in enumerate(POINTS.tolist())]
    path.write_text("# points\n" + "\n".join(lines) + "\n")


def pcd(path: Path, kind: str) -> None:
    rows = np.column_stack([POINTS, np.arange(len(POINTS))])
    if kind == "ascii":
        body = "\n".join(f"{x:.4f} {y:.4f} {z:.4f} {int(c)}" for x, y, z, c in rows).encode()
    else:
        body = rows.astype("<f4").tobytes()
    path.write_bytes(PCD.format(kind=kind).encode() + body)


def mcap(path: Path) -> None:
    writer = StageFileWriter(path, {"stage": "ingest", "key": "0" * 32, "parts": "{}"})
    for _ in range(3):
        writer.write(CLOUD, CloudTile(POINTS.astype(np.float32), np.zeros((60, 3), np.uint8)))
    writer.close({"seconds": "1"})


def log(path: Path) -> None:
    from mcap_protobuf.writer import Writer

    with path.open("wb") as stream, Writer(stream) as writer:
        for _ in range(3):
            tile = CloudTile(POINTS.astype(np.float32), np.zeros((60, 3), np.uint8))
            writer.write_message("/points", CLOUD.encode(tile), log_time=1, publish_time=1)


def e57(path: Path) -> None:
    import pye57

    path.unlink(missing_ok=True)
    columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), POINTS.T.copy(), strict=True))
    with pye57.E57(str(path), "w") as file:
        file.write_scan_raw(columns)


def ros_log(path: Path) -> None:
    """PointCloud2 of ROS 1 and 2, and messages and metadata that are not ours."""
    from mcap.writer import Writer

    fields = b"".join(
        struct.pack("<I", 1) + axis + struct.pack("<IBI", 4 * i, 7, 1)
        for i, axis in enumerate((b"x", b"y", b"z"))
    )
    data = POINTS.astype("<f4").tobytes()
    message = (
        struct.pack("<IIII", 3, 7, 5, 3) + b"map" + struct.pack("<III", 1, len(POINTS), 3)
        + fields + struct.pack("<?III", False, 12, len(data), len(data)) + data + b"\1"
    )  # fmt: skip
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros1")
        schema = writer.register_schema("sensor_msgs/PointCloud2", "ros1msg", b"")
        other = writer.register_schema("std_msgs/String", "ros1msg", b"string data")
        cloud = writer.register_channel("/points", "ros1", schema, {"latching": "?"})
        text = writer.register_channel("/text", "ros1", other)
        for i in range(3):
            writer.add_message(cloud, log_time=i, publish_time=i, data=message)
            writer.add_message(text, log_time=i, publish_time=i, data=b"\3\0\0\0abc")
        writer.add_metadata("stage", {"key": "of another program", "parts": "[]"})
        writer.finish()


def bundler(path: Path) -> None:
    """[Snavely, Bundler manual]: cameras, then points with colours and where they were seen."""
    lines = ["# Bundle file v0.3", f"2 {len(POINTS)}"]
    for move in (1, 2):
        lines += ["50 0 0", "1 0 0", "0 1 0", "0 0 1", f"0 0 {move}"]
    for x, y, z in POINTS.tolist():
        lines += [f"{x:.4f} {y:.4f} {z:.4f}", "9 8 7", "1 0 0 3.5 4.5"]
    path.write_text("\n".join(lines) + "\n")


def patches(path: Path) -> None:
    lines = ["PATCHES", str(len(POINTS))]
    for x, y, z in POINTS.tolist():
        lines += ["PATCHS", f"{x:.4f} {y:.4f} {z:.4f} 1", "0 0 1 0", "0.9 1 0", "1", "0", "0", ""]
    path.write_text("\n".join(lines) + "\n")


def opensfm(path: Path) -> None:
    shots = {f"{i}.jpg": {"rotation": [0, 0, 0.1], "translation": [0, i, 1]} for i in range(2)}
    points = {
        str(i): {"coordinates": xyz, "color": [9, 8, 7]} for i, xyz in enumerate(POINTS.tolist())
    }
    document = {"cameras": {}, "shots": shots, "points": points, "reference_lla": {"latitude": 1}}
    path.write_text(json.dumps([document]))


def mesh(path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=1).export(path)


def labels(path: Path) -> None:
    path.write_text("model,x,y,z,heading_deg,ignore\nsaloon,1,2,0,30,\n,3,-4,0,,1\n")


def read_scene(path: Path) -> None:
    if path.name in ("images.bin", "points3D.bin", "points3D.txt"):
        path = path.parent
    for _ in open_scene(path).chunks(1000):
        pass


def read_object(path: Path) -> None:
    config = ModelConfig(name="m", path=path, samples=100)
    object_model(config, read_model(config), np.random.default_rng(0))


def read_mcap(path: Path) -> None:
    read_metadata(path, "stage")
    for _ in Messages(path, CLOUD):
        pass


def read_labels(path: Path) -> None:
    frame = SceneFrame((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 60, 0, coloured=True, source="s")
    read_truth(path, frame, Upright((0, 0, 0, 1), (0, 0, 0)), "scene")


FORMATS: dict[str, tuple[str, Callable[[Path], object], Callable[[Path], object]]] = {
    "ply": ("a.ply", lambda p: ply(p, text=False), read_scene),
    "ply-text": ("a.ply", lambda p: ply(p, text=True), read_scene),
    "ply-mesh": ("m.ply", mesh, read_object),
    "las": ("a.las", las, read_scene),
    "laz": ("a.laz", las, read_scene),
    "colmap-points": ("points3D.bin", colmap_points, read_scene),
    "colmap-images": ("images.bin", colmap_images, read_scene),
    "colmap-text": ("points3D.txt", colmap_text, read_scene),
    "pcd-text": ("a.pcd", lambda p: pcd(p, "ascii"), read_scene),
    "pcd": ("a.pcd", lambda p: pcd(p, "binary"), read_scene),
    "text": ("a.xyz", lambda p: np.savetxt(p, POINTS, fmt="%.4f"), read_scene),
    "obj": ("m.obj", mesh, read_object),
    "stl": ("m.stl", mesh, read_object),
    "off": ("m.off", mesh, read_object),
    "glb": ("m.glb", mesh, read_object),
    "gltf": ("m.gltf", mesh, read_object),
    "toml": ("c.toml", lambda p: p.write_text(CONFIG), load_config),
    "mcap": ("01_ingest.mcap", mcap, read_mcap),
    "log": ("a.mcap", log, read_scene),
    "ros-log": ("a.mcap", ros_log, read_scene),
    "e57": ("a.e57", e57, read_scene),
    "bundler": ("bundle.out", bundler, read_scene),
    "patch": ("option.patch", patches, read_scene),
    "opensfm": ("reconstruction.json", opensfm, read_scene),
    "dae": ("m.dae", mesh, read_object),
    "labels": ("t.csv", labels, read_labels),
}
"""File name, what writes a whole one, what reads it; by format."""
