"""Codecs between records and Foxglove's protobuf messages, which viewers draw as they are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame

from spinpipe.schemas.arrays import F32, F64, U8
from spinpipe.schemas.poses import Calibration, Cameras, InstancePoses, Trajectory
from spinpipe.schemas.records import CloudTile, ScoreTile, Upright

_FLOAT32 = PackedElementField.NumericType.FLOAT32
_UINT8 = PackedElementField.NumericType.UINT8
_XYZ = tuple((name, 4 * i, _FLOAT32) for i, name in enumerate("xyz"))
_RGBA = tuple((n, 12 + i, _UINT8) for i, n in enumerate(("red", "green", "blue", "alpha")))


def _cloud(frame: str, rows: np.ndarray, fields: tuple[tuple[str, int, int], ...]) -> PointCloud:
    message = PointCloud(frame_id=frame, point_stride=rows.dtype.itemsize, data=rows.tobytes())
    message.pose.orientation.w = 1.0  # a pose must be complete or unset
    for name, offset, kind in fields:
        message.fields.add(name=name, offset=offset, type=kind)
    return message


def _rows(message: PointCloud, dtype: np.dtype) -> np.ndarray:
    return np.frombuffer(message.data, dtype=dtype)


_TILE = np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4)])


def point_cloud(frame: str, xyz: F32, rgb: U8) -> PointCloud:
    """Coordinates (N, 3) and colours (N, 3) -> coloured point cloud in a frame."""
    rows = np.empty(len(xyz), dtype=_TILE)
    rows["xyz"] = xyz
    rows["rgba"][:, :3] = rgb
    rows["rgba"][:, 3] = 255
    return _cloud(frame, rows, _XYZ + _RGBA)


def encode_tile(tile: CloudTile) -> PointCloud:
    """Cloud tile -> coloured point cloud in frame ``local``."""
    return point_cloud("local", tile.xyz, tile.rgb)


def decode_tile(data: bytes) -> CloudTile:
    """Point cloud -> cloud tile."""
    rows = _rows(PointCloud.FromString(data), _TILE)
    return CloudTile(np.ascontiguousarray(rows["xyz"]), np.ascontiguousarray(rows["rgba"][:, :3]))


def _score_dtype(models: int) -> np.dtype:
    return np.dtype([("xyz", "<f4", 3), ("rgba", "u1", 4), ("correlation", "<f4", (models,))])


def encode_scores(scores: ScoreTile) -> PointCloud:
    """Scored origins -> point cloud in frame ``world`` with a field ``correlation/<model>``."""
    rows = np.empty(len(scores.points), dtype=_score_dtype(len(scores.models)))
    rows["xyz"] = scores.points
    rows["rgba"][:, :3] = scores.rgb
    rows["rgba"][:, 3] = 255
    rows["correlation"] = scores.correlation
    fields = tuple(
        (f"correlation/{model}", 16 + 4 * i, _FLOAT32) for i, model in enumerate(scores.models)
    )
    return _cloud("world", rows, _XYZ + _RGBA + fields)


def decode_scores(data: bytes) -> ScoreTile:
    """Point cloud -> scored origins."""
    message = PointCloud.FromString(data)
    prefix = "correlation/"
    models = tuple(f.name.removeprefix(prefix) for f in message.fields if prefix in f.name)
    rows = _rows(message, _score_dtype(len(models)))
    return ScoreTile(
        models=models,
        points=np.ascontiguousarray(rows["xyz"]),
        correlation=np.ascontiguousarray(rows["correlation"]),
        rgb=np.ascontiguousarray(rows["rgba"][:, :3]),
    )


def encode_upright(upright: Upright) -> FrameTransform:
    """Upright transform -> transform of child frame ``local`` in parent frame ``world``."""
    message = FrameTransform()
    _set_transform(message, "world", "local", upright.translation, upright.quaternion_xyzw)
    return message


def decode_upright(data: bytes) -> Upright:
    """Frame transform -> upright transform."""
    message = FrameTransform.FromString(data)
    q, t = message.rotation, message.translation
    return Upright((q.x, q.y, q.z, q.w), (t.x, t.y, t.z))


def encode_cameras(cameras: Cameras) -> FrameTransforms:
    """Cameras -> a child frame of ``local`` each, called like its photo."""
    message = FrameTransforms()
    for name, place, turn in zip(
        cameras.names, cameras.positions.tolist(), cameras.quaternions_xyzw.tolist(), strict=True
    ):
        _set_transform(message.transforms.add(), "local", name, place, turn)
    return message


def decode_cameras(data: bytes) -> Cameras:
    """Frames -> cameras."""
    transforms = FrameTransforms.FromString(data).transforms
    return Cameras(*_places(transforms), tuple(t.child_frame_id for t in transforms))


def encode_calibration(calibration: Calibration) -> CameraCalibration:
    """Calibration -> camera calibration in the frame that is called like the photo."""
    return CameraCalibration(
        frame_id=calibration.camera,
        width=calibration.width,
        height=calibration.height,
        distortion_model=calibration.distortion_model,
        D=calibration.D,
        K=calibration.K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.column_stack([calibration.K, np.zeros(3)]).ravel().tolist(),
    )


def decode_calibration(data: bytes) -> Calibration:
    """Camera calibration -> calibration."""
    message = CameraCalibration.FromString(data)
    return Calibration(
        message.frame_id,
        message.width,
        message.height,
        np.array(message.K).reshape(3, 3),
        message.distortion_model,
        tuple(message.D),
    )


def encode_trajectory(trajectory: Trajectory) -> FrameTransforms:
    """Trajectory -> child frame ``lidar`` of ``local`` at the time of each sweep."""
    message = FrameTransforms()
    for time_ns, place, turn in zip(
        trajectory.times_ns.tolist(),
        trajectory.positions.tolist(),
        trajectory.quaternions_xyzw.tolist(),
        strict=True,
    ):
        transform = message.transforms.add()
        transform.timestamp.FromNanoseconds(time_ns)
        _set_transform(transform, "local", "lidar", place, turn)
    return message


def decode_trajectory(data: bytes) -> Trajectory:
    """Frames -> trajectory."""
    transforms = FrameTransforms.FromString(data).transforms
    times = np.array([t.timestamp.ToNanoseconds() for t in transforms], np.int64)
    return Trajectory(*_places(transforms), times)


def _set_transform(
    message: FrameTransform,
    parent: str,
    child: str,
    translation: Sequence[float],
    quaternion_xyzw: Sequence[float],
) -> None:
    message.parent_frame_id, message.child_frame_id = parent, child
    r, t = message.rotation, message.translation
    r.x, r.y, r.z, r.w = quaternion_xyzw
    t.x, t.y, t.z = translation


def _places(transforms: Iterable[FrameTransform]) -> tuple[F64, F64]:
    """Positions (N, 3) and quaternions (N, 4)."""
    return _poses((t.translation, t.rotation) for t in transforms)


def _poses(found: Iterable[tuple[Any, Any]]) -> tuple[F64, F64]:
    """Positions (N, 3) and quaternions (N, 4) of messages with these members."""
    rows = np.array([(p.x, p.y, p.z, q.x, q.y, q.z, q.w) for p, q in found]).reshape(-1, 7)
    return rows[:, :3].copy(), rows[:, 3:].copy()


def encode_instances(instances: InstancePoses) -> PosesInFrame:
    """Accepted instances -> poses in frame ``world``."""
    message = PosesInFrame(frame_id="world")
    for p, q in zip(instances.positions.tolist(), instances.quaternions_xyzw.tolist(), strict=True):
        pose = message.poses.add()
        pose.position.x, pose.position.y, pose.position.z = p
        o = pose.orientation
        o.x, o.y, o.z, o.w = q
    return message


def decode_instances(data: bytes) -> InstancePoses:
    """Poses -> accepted instances."""
    poses = PosesInFrame.FromString(data).poses
    return InstancePoses(*_poses((p.position, p.orientation) for p in poses))
