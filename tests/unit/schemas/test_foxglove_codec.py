"""Clouds, transforms and poses as Foxglove messages: the bytes that any viewer reads."""

from __future__ import annotations

from typing import Any

import numpy as np
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from spinpipe.schemas import (
    CALIBRATIONS,
    CAMERAS,
    CLOUD,
    INSTANCES,
    SCORES,
    TRAJECTORY,
    UPRIGHT,
)
from spinpipe.schemas import records as r
from spinpipe.schemas.poses import Calibration, Cameras, InstancePoses, Trajectory


def points(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 10, (count, 3)).astype(np.float32)


def colours(count: int) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (count, 3)).astype(np.uint8)


def field_values(message: PointCloud, name: str) -> np.ndarray:
    """One field of a cloud, read by nothing but what the message says of itself."""
    field = next(f for f in message.fields if f.name == name)
    kind = {1: "u1", 7: "<f4"}[field.type]
    count = len(message.data) // message.point_stride
    dtype = np.dtype(
        {
            "names": ["v"],
            "formats": [kind],
            "offsets": [field.offset],
            "itemsize": message.point_stride,
        }
    )
    return np.frombuffer(message.data, dtype, count)["v"]


def test_a_tile_reads_as_its_message_says() -> None:
    xyz, rgb = points(50), colours(50)
    message = CLOUD.encode(r.CloudTile(xyz, rgb))
    assert isinstance(message, PointCloud)
    assert message.frame_id == "local"
    for axis, values in zip("xyz", xyz.T, strict=True):
        np.testing.assert_array_equal(field_values(message, axis), values)
    for name, values in zip(("red", "green", "blue"), rgb.T, strict=True):
        np.testing.assert_array_equal(field_values(message, name), values)
    assert set(field_values(message, "alpha")) == {255}
    assert message.pose.orientation.w == 1.0


@given(
    xyz=hnp.arrays(np.float32, st.tuples(st.integers(0, 20), st.just(3))),
)
def test_a_tile_comes_back_bit_for_bit(xyz: np.ndarray) -> None:
    tile = r.CloudTile(xyz, colours(len(xyz)))
    back = CLOUD.decode(CLOUD.encode(tile).SerializeToString())
    assert back.xyz.tobytes() == xyz.tobytes()
    np.testing.assert_array_equal(back.rgb, tile.rgb, strict=True)


def test_scores_come_back_with_a_column_a_model() -> None:
    for models in ((), ("car",), ("car", "van-2", "a.b_c")):
        correlation = np.random.default_rng(2).uniform(-1, 1, (9, len(models))).astype(np.float32)
        tile = r.ScoreTile(models, points(9), correlation, colours(9))
        message = SCORES.encode(tile)
        assert isinstance(message, PointCloud)
        assert message.frame_id == "world"
        for i, model in enumerate(models):
            np.testing.assert_array_equal(
                field_values(message, f"correlation/{model}"), correlation[:, i]
            )
        back = SCORES.decode(message.SerializeToString())
        assert back.models == models
        np.testing.assert_array_equal(back.correlation, correlation, strict=True)
        np.testing.assert_array_equal(back.points, tile.points, strict=True)
        np.testing.assert_array_equal(back.rgb, tile.rgb, strict=True)


def test_scores_of_an_empty_tile_keep_their_models() -> None:
    empty = r.ScoreTile(
        ("car", "van"),
        np.empty((0, 3), np.float32),
        np.empty((0, 2), np.float32),
        np.empty((0, 3), np.uint8),
    )
    back = SCORES.decode(SCORES.encode(empty).SerializeToString())
    assert back.models == ("car", "van")
    assert back.correlation.shape == (0, 2)


def test_upright_comes_back_and_is_a_rotation() -> None:
    q = np.random.default_rng(5).normal(size=4)
    x, y, z, w = (q / np.linalg.norm(q)).tolist()
    upright = r.Upright((x, y, z, w), (1.5, -2.0, 1e7))
    assert UPRIGHT.decode(UPRIGHT.encode(upright).SerializeToString()) == upright
    R = upright.T_world_local[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) > 0


def test_poses_come_back_also_when_there_are_none() -> None:
    rng = np.random.default_rng(3)
    for count in (0, 1, 7):
        positions, quaternions = rng.normal(size=(count, 3)), rng.normal(size=(count, 4))
        names = tuple(f"photos/{i}.jpg" for i in range(count))
        cameras = CAMERAS.decode(
            CAMERAS.encode(Cameras(positions, quaternions, names)).SerializeToString()
        )
        np.testing.assert_array_equal(cameras.positions, positions)
        np.testing.assert_array_equal(cameras.quaternions_xyzw, quaternions)
        assert cameras.names == names
        times = rng.integers(0, 2**62, count)
        path = TRAJECTORY.decode(
            TRAJECTORY.encode(Trajectory(positions, quaternions, times)).SerializeToString()
        )
        np.testing.assert_array_equal(path.positions, positions)
        np.testing.assert_array_equal(path.quaternions_xyzw, quaternions)
        np.testing.assert_array_equal(path.times_ns, times)
        poses = INSTANCES.decode(
            INSTANCES.encode(InstancePoses(positions, quaternions)).SerializeToString()
        )
        np.testing.assert_array_equal(poses.positions, positions)
        np.testing.assert_array_equal(poses.quaternions_xyzw, quaternions)


def test_a_calibration_comes_back_and_is_complete() -> None:
    K = np.array([[800.0, 0, 319.5], [0, 810.0, 239.5], [0, 0, 1]])
    calibration = Calibration("a.jpg", 640, 480, K, "plumb_bob", (0.1, 0.0, 0.0, 0.0, 0.0))
    message: Any = CALIBRATIONS.encode(calibration)
    back = CALIBRATIONS.decode(message.SerializeToString())
    np.testing.assert_array_equal(back.K, K)
    assert (back.camera, back.width, back.height) == ("a.jpg", 640, 480)
    assert (back.distortion_model, back.D) == (calibration.distortion_model, calibration.D)
    assert (len(message.K), len(message.R), len(message.P)) == (9, 9, 12)
