"""Logs: clouds as ROS 1, ROS 2 and Foxglove write them, and sweeps that become one."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros1.decoder import DecoderFactory as Ros1Decoder
from mcap_ros2.writer import Writer as Ros2Writer
from scipy.spatial.transform import Rotation

from spinpipe.schemas.arrays import F64
from spinpipe.stages.ingest.odometry import Odometry, registered
from spinpipe.stages.ingest.readers.cloud_message import decoder
from spinpipe.stages.ingest.readers.mcap import McapSource
from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.stage import StageError

ROW = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("_", "<u4"), ("rgb", "<u4"), ("t", "<u4")]
)
ROWS = np.zeros(6, ROW)
ROWS["x"], ROWS["y"], ROWS["z"] = np.random.default_rng(0).normal(0, 10, (3, 6))
ROWS["rgb"] = 0x00112233 + np.arange(6)
XYZ = np.stack([ROWS[axis] for axis in "xyz"], axis=1).astype(np.float64)
RGB = np.tile([0x11, 0x22, 0x33], (6, 1)) + np.arange(6)[:, None] * [0, 0, 1]
FIELDS = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("rgb", 16, 6), ("t", 20, 6)]

ROS2_TEXT = """std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
{line}
MSG: sensor_msgs/PointField
string name
uint32 offset
uint8 datatype
uint32 count
{line}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{line}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
""".format(line="=" * 80)


def ros1_message(rows: Any, frame: str = "lidar", seconds: int = 7, pad: int = 0) -> bytes:
    """PointCloud2 as [wiki.ros.org/msg] lays it out, two rows of an image with some padding."""

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    height, width = 2, len(rows) // 2
    data = b"".join(
        rows[i * width : (i + 1) * width].tobytes() + b"\xff" * pad for i in range(height)
    )
    step = rows.dtype.itemsize
    fields = b"".join(text(n) + struct.pack("<IBI", o, t, 1) for n, o, t in FIELDS)
    return (
        struct.pack("<III", 3, seconds, 5) + text(frame) + struct.pack("<II", height, width)
        + struct.pack("<I", len(FIELDS)) + fields
        + struct.pack("<?II", False, step, step * width + pad)
        + struct.pack("<I", len(data)) + data + b"\1"
    )  # fmt: skip


def write_ros1(path: Path, messages: Sequence[tuple[str, bytes]], finish: bool = True) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros1")
        schema = writer.register_schema("sensor_msgs/PointCloud2", "ros1msg", b"")
        channels = {topic: writer.register_channel(topic, "ros1", schema) for topic, _ in messages}
        for i, (topic, data) in enumerate(messages):
            writer.add_message(channels[topic], log_time=i, publish_time=i, data=data)
        if finish:
            writer.finish()
    return path


def write_ros2(path: Path) -> None:
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        schema = writer.register_msgdef("sensor_msgs/msg/PointCloud2", ROS2_TEXT)
        fields = [SimpleNamespace(name=n, offset=o, datatype=t, count=1) for n, o, t in FIELDS]
        stamp = SimpleNamespace(sec=7, nanosec=5)
        message = SimpleNamespace(
            header=SimpleNamespace(stamp=stamp, frame_id="lidar"), height=1, width=len(ROWS),
            fields=fields, is_bigendian=False, point_step=ROW.itemsize,
            row_step=len(ROWS) * ROW.itemsize, data=ROWS.tobytes(), is_dense=True,
        )  # fmt: skip
        writer.write_message("/points", schema, message)
        writer.finish()


def foxglove_message() -> PointCloud:
    message = PointCloud(frame_id="lidar", point_stride=ROW.itemsize, data=ROWS.tobytes())
    message.timestamp.FromNanoseconds(7_000_000_005)
    message.pose.position.x = 100
    message.pose.orientation.z = message.pose.orientation.w = np.sqrt(0.5)
    for name, offset, kind in FIELDS:
        message.fields.add(name=name, offset=offset, type={7: 7, 6: 5}[kind])
    return message


def write_protobuf(path: Path) -> None:
    with path.open("wb") as file, ProtobufWriter(file) as writer:
        writer.write_message("/points", foxglove_message())


def write_json(path: Path) -> None:
    document = {
        "timestamp": {"sec": 7, "nsec": 5}, "frame_id": "lidar", "point_stride": ROW.itemsize,
        "pose": {
            "position": {"x": 100, "y": 0, "z": 0},
            "orientation": {"x": 0, "y": 0, "z": 0.5**0.5, "w": 0.5**0.5},
        },
        "fields": [{"name": n, "offset": o, "type": {7: 7, 6: 5}[t]} for n, o, t in FIELDS],
        "data": base64.b64encode(ROWS.tobytes()).decode(),
    }  # fmt: skip
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.PointCloud", "jsonschema", b"{}")
        channel = writer.register_channel("/points", "json", schema)
        writer.add_message(channel, 1, json.dumps(document).encode(), 1)
        writer.finish()


@pytest.mark.parametrize(
    ("write", "placed"),
    [
        (lambda path: write_ros1(path, [("/points", ros1_message(ROWS, pad=5))]), False),
        (write_ros2, False),
        (write_protobuf, True),
        (write_json, True),
    ],
    ids=["ros1", "ros2", "protobuf", "json"],
)
def test_one_cloud_is_a_scene(write: Callable[[Path], None], placed: bool, tmp_path: Path) -> None:
    path = tmp_path / "named.anything"
    write(path)
    source = open_scene(path)
    assert (source.points, source.coloured) == (6, True)
    assert "on /points" in source.about.kind
    assert source.about.fields == ("rgb", "t")
    xyz, rgb = (np.concatenate(parts) for parts in zip(*source.chunks(4), strict=True))
    expected = XYZ @ Rotation.from_euler("z", 90, degrees=True).as_matrix().T + [100, 0, 0]
    np.testing.assert_allclose(xyz, expected if placed else XYZ, atol=1e-9)
    np.testing.assert_array_equal(rgb, RGB)
    assert isinstance(source, McapSource)
    (sweep,) = source.messages()
    assert (sweep.time_ns, source.frame) == (7_000_000_005, "lidar")
    assert sweep.times is not None


def test_a_real_log_reads_as_ros_reads_it(shared_data: Path) -> None:
    path = shared_data / "mcap-ouster" / "pointcloudset_test.mcap"
    source = McapSource(path)
    assert (source.sweeps, source.points, source.in_fixed_frame) == (2, 262_144, False)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[Ros1Decoder()])
        found = reader.iter_decoded_messages(["/os1_cloud_node/points"])
        for ours, (*_, theirs) in zip(source.messages(), found, strict=True):
            table = np.frombuffer(theirs.data, np.uint8).reshape(-1, theirs.point_step)
            xyz = np.ascontiguousarray(table[:, :12]).view("<f4")
            np.testing.assert_array_equal(ours.xyz, xyz)
            assert ours.time_ns == theirs.header.stamp.to_nsec()


def test_of_several_topics_one_is_chosen(tmp_path: Path) -> None:
    message = ros1_message(ROWS)
    path = write_ros1(tmp_path / "a.mcap", [("/a", message), ("/b", message), ("/b", message)])
    with pytest.raises(
        StageError, match=r"/a \(1 x 6 points\), /b \(2 x 6 points\).*ingest\] topic"
    ):
        open_scene(path)
    with pytest.raises(StageError, match=r"no clouds on \[ingest\] topic = '/c'; they are on /a"):
        open_scene(path, "/c")
    assert open_scene(path, "/b").points == 12
    cloud = tmp_path / "cloud.xyz"
    cloud.write_text("0 0 0\n1 1 1\n")
    with pytest.raises(StageError, match=r"only MCAP files have topics"):
        open_scene(cloud, "/b")


def test_an_empty_topic_beside_is_none(tmp_path: Path) -> None:
    messages = [("/a", ros1_message(ROWS)), ("/b", ros1_message(ROWS[:0]))]
    assert open_scene(write_ros1(tmp_path / "a.mcap", messages)).points == 6
    with pytest.raises(StageError, match="the cloud is empty"):
        open_scene(write_ros1(tmp_path / "b.mcap", messages[1:]))


def test_what_holds_no_clouds_says_what_it_holds(tmp_path: Path) -> None:
    path = tmp_path / "imu.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"")
        channel = writer.register_channel("/imu", "cdr", schema)
        writer.add_message(channel, 1, b"1234", 1)
        writer.finish()
    with pytest.raises(StageError, match=r"holds clouds.*it holds /imu \(sensor_msgs/msg/Imu\)"):
        open_scene(path)


def test_a_log_cut_anywhere_or_damaged_says_so(tmp_path: Path) -> None:
    whole = write_ros1(tmp_path / "a.mcap", [("/a", ros1_message(ROWS))] * 3).read_bytes()
    path = tmp_path / "cut.mcap"
    for length in range(20, len(whole), 37):
        path.write_bytes(whole[:length])
        with pytest.raises(StageError, match=r"^[^\n]*(cannot read the MCAP|no topic)[^\n]*$"):
            list(open_scene(path).chunks(10))
    flipped = bytearray(whole)
    flipped[300] ^= 1
    path.write_bytes(flipped)
    with pytest.raises(StageError, match="cannot read the MCAP"):
        open_scene(path)


def test_a_log_without_an_index_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start("ros1")
        schema = writer.register_schema("sensor_msgs/PointCloud2", "ros1msg", b"")
        channel = writer.register_channel("/a", "ros1", schema)
        writer.add_message(channel, 1, ros1_message(ROWS), 1)
        writer.finish()
    assert open_scene(path).points == 6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:-80], "bytes are missing"),
        (lambda data: data[:30], "ends too early"),
        (lambda data: data[:3], "ends too early"),
        (lambda data: data.replace(b"\1\0\0\0x", b"\1\0\0\0q"), "no field x"),
        (lambda data: data.replace(b"\1\0\0\0x\0\0\0\0\7", b"\1\0\0\0x\0\0\0\0\x63"), "type 99"),
        (lambda data: data.replace(b"\1\0\0\0x\0\0\0\0", b"\1\0\0\0x\xff\xff\xff\x7f"), "outs"),
        (
            lambda data: data.replace(b"lidar\2\0\0\0", b"lidar\xff\xff\xff\xff"),
            "do not fit",
        ),
    ],
)
def test_a_damaged_message_says_so(
    change: Callable[[bytes], bytes], message: str, tmp_path: Path
) -> None:
    damaged = change(ros1_message(ROWS))
    path = write_ros1(tmp_path / "a.mcap", [("/a", damaged)])
    with pytest.raises(StageError, match=f"a message on /a is damaged: .*{message}"):
        open_scene(path)
    decode = decoder("sensor_msgs/PointCloud2", "ros1")
    assert decode is not None
    with pytest.raises(ValueError, match=message):
        decode(damaged)


def sweeps_of_a_hall(path: Path, count: int, frame: str = "lidar") -> F64:
    """A lidar that drives and turns through a hall, its points taken one after the other.

    Returns the poses (count, 4, 4) at the end of each sweep, in the frame of the first.
    """
    rng = np.random.default_rng(0)
    step = np.array([0.5, 0.05, 0.0]), np.radians([0, 0, 8.0])
    messages: list[tuple[str, bytes]] = []
    poses: list[F64] = []
    for number in range(count):
        when = number + np.sort(rng.uniform(size=6000))

        turn = Rotation.from_rotvec(when[:, None] * step[1])
        place = when[:, None] * step[0] + [-6, -2, 1.6]
        points = hall(rng, 6000)
        rows = np.zeros(6000, ROW)
        rows["x"], rows["y"], rows["z"] = turn.inv().apply(points - place).T
        rows["t"] = 1e8 * (when - number)
        messages.append(("/points", ros1_message(rows, frame, number)))
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec((number + 1) * step[1]).as_matrix()
        pose[:3, 3] = (number + 1) * step[0]
        poses.append(pose)
    write_ros1(path, messages)
    return np.linalg.inv(poses[0]) @ poses


def hall(rng: np.random.Generator, count: int) -> F64:
    """Points (count, 3) on walls, floor and pillars of a hall of 24 x 14 x 5 m."""
    points = rng.uniform([-12, -7, 0], [12, 7, 5], (count, 3))
    face = rng.integers(0, 6, count)
    for side, (axis, value) in enumerate([(0, -12), (0, 12), (1, -7), (1, 7), (2, 0)]):
        points[face == side, axis] = value
    pillar = face == 5
    points[pillar, :2] = rng.choice([(-8, 5), (-2, -5), (3, 4), (9, -4)], pillar.sum())
    points[pillar, :2] += rng.uniform(-0.3, 0.3, (pillar.sum(), 2))
    sides = rng.integers(0, 2, pillar.sum())
    rows = np.flatnonzero(pillar)
    points[rows, sides] += 0.3 - (points[rows, sides] - np.rint(points[rows, sides]))
    return points


def test_sweeps_are_registered_and_deskewed(tmp_path: Path) -> None:
    truth = sweeps_of_a_hall(tmp_path / "a.mcap", 9)
    log = McapSource(tmp_path / "a.mcap")
    assert (log.sweeps, log.in_fixed_frame) == (9, False)
    read: list[int] = []
    off: dict[bool, float] = {}
    for deskew in (True, False):
        rules = Odometry(deskew=deskew, voxel_m=0.7, map_voxel_m=0.1)
        scene = registered(log, rules, read.append)
        path = scene.about.trajectory
        assert path is not None
        # the first two, before there is a motion to undo, are not deskewed
        errors = path.positions - truth[:, :3, 3]
        off[deskew] = float(np.linalg.norm(errors[2:] - errors[2], axis=1).max())
        assert path.times_ns[3] == 3_000_000_005
        assert f"9 sweeps registered by KISS-ICP ({9 * deskew} deskewed)" in scene.about.notes[0]
        cells = np.unique(np.floor(scene.xyz / 0.1), axis=0)
        assert len(cells) == len(scene.xyz), "one point a cell"
    assert sum(read) == 2 * log.points
    assert off[True] < 0.15 < off[False]


def test_equal_logs_give_equal_scenes(tmp_path: Path) -> None:
    sweeps_of_a_hall(tmp_path / "a.mcap", 2)
    log = McapSource(tmp_path / "a.mcap")
    first, second = (registered(log, Odometry(), lambda _: None).xyz for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_sweeps_in_a_fixed_frame_are_taken_as_they_are(tmp_path: Path) -> None:
    sweeps_of_a_hall(tmp_path / "a.mcap", 2, frame="/map")
    source = open_scene(tmp_path / "a.mcap")
    assert isinstance(source, McapSource)
    assert source.in_fixed_frame
    assert "2 sweeps" in source.about.kind


def test_a_sweep_of_another_place_ends_the_odometry(tmp_path: Path) -> None:
    sweeps_of_a_hall(tmp_path / "a.mcap", 4)
    log = McapSource(tmp_path / "a.mcap")
    with pytest.raises(StageError, match=r"no sweep has 100 points between.*min_range_m = 90"):
        registered(log, Odometry(min_range_m=90), lambda _: None)
    sparse = ROWS.repeat(40)
    rng = np.random.default_rng(1)
    messages: list[tuple[str, bytes]] = []
    for number in range(3):
        sparse["x"], sparse["y"], sparse["z"] = rng.uniform(-90, 90, (3, len(sparse)))
        messages.append(("/points", ros1_message(sparse, seconds=number)))
    log = McapSource(write_ros1(tmp_path / "b.mcap", messages))
    with pytest.raises(StageError, match=r"sweep 2: the odometry lost its way, \d+% of"):
        registered(log, Odometry(), lambda _: None)
