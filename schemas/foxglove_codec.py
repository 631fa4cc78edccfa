"""Codecs between records and Foxglove's protobuf messages, which viewers draw as they are."""

from __future__ import annotations

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame

from spinpipe.schemas.arrays import F32, F64, U8
from spinpipe.schemas.records import Cameras, CloudTile, InstancePoses, ScoreTile, Upright

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
    message = FrameTransform(parent_frame_id="world", child_frame_id="local")
    x, y, z, w = upright.quaternion_xyzw
    message.rotation.x, message.rotation.y, message.rotation.z, message.rotation.w = x, y, z, w
    t = message.translation
    t.x, t.y, t.z = upright.translation
    return message


def decode_upright(data: bytes) -> Upright:
    """Frame transform -> upright transform."""
    message = FrameTransform.FromString(data)
    q, t = message.rotation, message.translation
    return Upright((q.x, q.y, q.z, q.w), (t.x, t.y, t.z))


def encode_cameras(cameras: Cameras) -> PosesInFrame:
    """Cameras -> poses in frame ``local``."""
    return _poses_in_frame("local", cameras.positions, cameras.quaternions_xyzw)


def decode_cameras(data: bytes) -> Cameras:
    """Poses -> cameras."""
    return Cameras(*_poses(data))


def encode_instances(instances: InstancePoses) -> PosesInFrame:
    """Accepted instances -> poses in frame ``world``."""
    return _poses_in_frame("world", instances.positions, instances.quaternions_xyzw)


def decode_instances(data: bytes) -> InstancePoses:
    """Poses -> accepted instances."""
    return InstancePoses(*_poses(data))


def _poses_in_frame(frame: str, positions: F64, quaternions_xyzw: F64) -> PosesInFrame:
    message = PosesInFrame(frame_id=frame)
    for p, q in zip(positions.tolist(), quaternions_xyzw.tolist(), strict=True):
        pose = message.poses.add()
        pose.position.x, pose.position.y, pose.position.z = p
        o = pose.orientation
        o.x, o.y, o.z, o.w = q
    return message


def _poses(data: bytes) -> tuple[F64, F64]:
    poses = PosesInFrame.FromString(data).poses
    positions = [(p.position.x, p.position.y, p.position.z) for p in poses]
    rotations = [
        (p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w) for p in poses
    ]
    return np.array(positions).reshape(-1, 3), np.array(rotations).reshape(-1, 4)
