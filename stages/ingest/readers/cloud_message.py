"""Messages that hold a point cloud: ROS 1 and ROS 2 PointCloud2, Foxglove's as protobuf and JSON.

PointCloud2 is read by its own fixed layout [sensor_msgs/PointCloud2, md5sum 1158d486dd51...]: a
reader for any message would be made from the text of the schema, which for ROS 1 means running
Python that the file brings along.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from google.protobuf import json_format
from google.protobuf.message import DecodeError
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from spinpipe.schemas.arrays import F64

_ROS_TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
"""Of PointField.datatype 1 to 8 [sensor_msgs/PointField]."""
_FOXGLOVE_TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8")
"""Of PackedElementField.type 1 to 8 [foxglove.PackedElementField]."""


@dataclass(frozen=True)
class CloudMessage:
    """One message: the points of one moment."""

    frame: str
    """Name of the frame that it is given in."""
    time_ns: int
    """Of its header; 0 where that has none."""
    rows: NDArray[Any]
    """(N,) structured: the fields of each point by name."""
    T_frame_points: F64
    """(4, 4) from coordinates of the points to the frame."""


Decode = Callable[[bytes], CloudMessage]


def decoder(schema: str, encoding: str) -> Decode | None:
    """What decodes a channel's messages; None where they are no clouds, or none that we can read.

    Parameters
    ----------
    schema : name of the message type.
    encoding : of the messages, by MCAP's well-known names.

    The function that is returned raises ``ValueError`` on messages that are damaged.
    """
    match schema, encoding:
        case "sensor_msgs/PointCloud2", "ros1":
            return _ros1
        case "sensor_msgs/msg/PointCloud2", "cdr":
            return _ros2
        case "foxglove.PointCloud", "protobuf":
            return _protobuf
        case "foxglove.PointCloud", "json":
            return _json
        case _:
            return None


class _Cursor:
    """Reads numbers and strings one after the other."""

    def __init__(self, data: bytes, at: int, order: str, cdr: bool) -> None:
        self._data, self._at, self._origin = data, at, at
        self._order, self._cdr = order, cdr

    def number(self, code: str) -> int:
        size = struct.calcsize(code)
        if self._cdr:  # numbers are aligned to their size
            self._at += -(self._at - self._origin) % size
        end = self._at + size
        if end > len(self._data):
            raise ValueError("it ends too early")
        (value,) = struct.unpack(self._order + code, self._data[self._at : end])
        self._at = end
        return value

    def bytes(self) -> memoryview:
        length = self.number("I")
        found = memoryview(self._data)[self._at : self._at + length]
        if len(found) < length:
            raise ValueError(f"{length - len(found):,} bytes are missing")
        self._at += length
        return found

    def text(self) -> str:
        return bytes(self.bytes()).decode("utf-8", "replace").rstrip("\0")


def _ros1(data: bytes) -> CloudMessage:
    cursor = _Cursor(data, 0, "<", cdr=False)
    cursor.number("I")  # header.seq
    return _pointcloud2(cursor)


def _ros2(data: bytes) -> CloudMessage:
    """CDR: two bytes that name the encoding, odd for little endian, two more, then the message."""
    if len(data) < 4 or data[1] > 1:
        raise ValueError("it is not in plain CDR")
    return _pointcloud2(_Cursor(data, 4, "<" if data[1] else ">", cdr=True))


def _pointcloud2(cursor: _Cursor) -> CloudMessage:
    seconds, nanoseconds = cursor.number("I"), cursor.number("I")
    frame = cursor.text()
    height, width = cursor.number("I"), cursor.number("I")
    fields = [
        (cursor.text(), cursor.number("I"), cursor.number("B"), cursor.number("I"))
        for _ in range(cursor.number("I"))
    ]
    order = ">" if cursor.number("B") else "<"
    step, row_step = cursor.number("I"), cursor.number("I")
    data = cursor.bytes()
    kinds = ((name, offset, kind, _ROS_TYPES) for name, offset, kind, _ in fields)
    dtype = _row(kinds, step, order)
    if height > 1 and row_step != width * step:  # rows of an image may be padded
        if row_step < width * step or len(data) < height * row_step:
            raise ValueError(f"{height:,} rows of {row_step:,} bytes are not there")
        table = np.frombuffer(data, np.uint8, height * row_step).reshape(height, row_step)
        data = np.ascontiguousarray(table[:, : width * step]).reshape(-1).data
    return CloudMessage(
        frame,
        seconds * 1_000_000_000 + nanoseconds,
        _rows(data, dtype, width * height),
        np.eye(4),
    )


def _protobuf(data: bytes) -> CloudMessage:
    try:
        return _foxglove(PointCloud.FromString(data))
    except DecodeError:
        raise ValueError("it is no foxglove.PointCloud") from None


def _json(data: bytes) -> CloudMessage:
    """By Foxglove's JSON schema: times in sec and nsec, numeric types as numbers, base64."""
    try:
        document = json.loads(data)
        time = document.pop("timestamp", {})
        blob = base64.b64decode(document.pop("data"), validate=True)
        message = json_format.ParseDict(document, PointCloud(), ignore_unknown_fields=True)
        message.timestamp.seconds = int(time.get("sec", 0))
        message.timestamp.nanos = int(time.get("nsec", 0))
    except (KeyError, TypeError, AttributeError, OverflowError, json_format.ParseError) as error:
        raise ValueError(f"it is no foxglove.PointCloud: {error}") from None
    message.data = blob
    return _foxglove(message)


def _foxglove(message: PointCloud) -> CloudMessage:
    fields = ((f.name, f.offset, f.type, _FOXGLOVE_TYPES) for f in message.fields)
    dtype = _row(fields, message.point_stride, "<")
    T_frame_points = np.eye(4)
    if message.HasField("pose"):
        p, q = message.pose.position, message.pose.orientation
        T_frame_points[:3, 3] = p.x, p.y, p.z
        if any((q.x, q.y, q.z, q.w)):  # one that is not set is no rotation
            T_frame_points[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    rows = _rows(memoryview(message.data), dtype, len(message.data) // dtype.itemsize)
    return CloudMessage(message.frame_id, message.timestamp.ToNanoseconds(), rows, T_frame_points)


def _row(
    fields: Iterable[tuple[str, int, int, tuple[str, ...]]], step: int, order: str
) -> np.dtype[Any]:
    """Type of a point from name, offset and type of its fields; of several values the first."""
    found: dict[str, tuple[str, int]] = {}
    for name, offset, kind, types in fields:
        if not 1 <= kind <= len(types):
            raise ValueError(f"field '{name}' has no numeric type {kind}")
        if offset + int(types[kind - 1][1]) > step:
            raise ValueError(f"field '{name}' lies outside of its point of {step:,} bytes")
        found.setdefault(name, (order + types[kind - 1], offset))
    missing = [axis for axis in "xyz" if axis not in found]
    if missing:
        raise ValueError(f"its points have no field {', '.join(missing)} (only {', '.join(found)})")
    formats, offsets = zip(*found.values(), strict=True)
    return np.dtype(
        {"names": list(found), "formats": formats, "offsets": offsets, "itemsize": step}
    )


def _rows(data: memoryview, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    if len(data) < count * dtype.itemsize:
        raise ValueError(f"{count:,} points do not fit into {len(data):,} bytes")
    return np.frombuffer(data, dtype, count)
