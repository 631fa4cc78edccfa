"""MCAP logs: the clouds of one topic, each message a sweep of the sensor or a cloud by itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from spinpipe.schemas.arrays import F64, U8
from spinpipe.stages.ingest.readers.cloud_message import CloudMessage, Decode, decoder
from spinpipe.stages.ingest.readers.coordinates import Coordinates
from spinpipe.stages.ingest.readers.guarded import guarded, readable
from spinpipe.stages.ingest.readers.point_fields import CHANNELS, colours_of, xyz_of
from spinpipe.stages.ingest.readers.scene_source import About, Chunk
from spinpipe.stages.stage import StageError

FIXED_FRAMES = ("map", "odom", "world", "earth", "local")
"""Frames that do not move with the sensor: those of ROS REP 105, and what Foxglove and we use."""

_LATEST_NS = 2**63 - 1
_MEND = "it may be cut short: copy it again, or save what is there with 'mcap recover'"
_METRES = Coordinates(name="metres", metres=(1.0, 1.0, 1.0), source="ROS REP 103")
_TIMES = ("t", "time", "timestamp", "timestamps", "time_stamp", "offset_time")
"""What drivers call the time of a point: Ouster, Velodyne, Hesai and Robosense, Livox."""


@dataclass(frozen=True)
class Sweep:
    """The points of one message."""

    xyz: F64
    """(N, 3) sensor frame, metres."""
    rgb: U8
    """(N, 3); white where there are no colours."""
    times: F64 | None
    """(N,) of the points in any unit from any beginning; None where they have none."""
    time_ns: int
    """Of the message."""


@dataclass(frozen=True)
class _Channel:
    """The clouds of one topic."""

    topic: str
    schema: str
    encoding: str
    sweeps: int
    points: int
    frame: str
    fields: tuple[str, ...]


class McapSource:
    """The points of a topic as they are, message after message.

    Parameters
    ----------
    path : of the file.
    topic : that holds the clouds; may be left out where there is only one.

    Raises
    ------
    StageError
        When it cannot be read to its end, has no clouds, or on several topics and none is chosen.
    """

    def __init__(self, path: Path, topic: str | None = None) -> None:
        self.path = path
        self._channel = _chosen(path, topic)
        found = self._channel
        self.points, self.sweeps, self.frame = found.points, found.sweeps, found.frame
        names = set(found.fields)
        self.coloured = bool(names & {"rgb", "rgba"}) or set(CHANNELS) <= names
        self.about = About(
            kind=f"MCAP, {found.schema} ({found.encoding}) on {found.topic}"
            + (f", {self.sweeps:,} sweeps" if self.sweeps > 1 else ""),
            fields=tuple(name for name in found.fields if name not in ("x", "y", "z")),
            coordinates=_METRES if found.schema.startswith("sensor_msgs/") else Coordinates(),
        )

    @property
    def in_fixed_frame(self) -> bool:
        """Whether the messages share a frame that does not move with the sensor."""
        return self.frame.strip("/") in FIXED_FRAMES

    def messages(self) -> Iterator[Sweep]:
        """The sweeps in the order of their time."""
        yield from guarded(_sweeps, self.path, self._channel.topic)

    def chunks(self, points: int) -> Iterator[Chunk]:
        """All points as they are, at most ``points`` at a time."""
        for sweep in self.messages():
            for start in range(0, len(sweep.xyz), points):
                yield sweep.xyz[start : start + points], sweep.rgb[start : start + points]


def _chosen(path: Path, topic: str | None) -> _Channel:
    found, others = next(guarded(_overview, path))
    channels = [c for c in found if c.topic == topic] if topic else found
    with_points = [c for c in channels if c.points]
    if len(with_points) == 1:
        return with_points[0]
    if not found:
        held = ", ".join(others) or "nothing"
        raise StageError(
            f"{path}: no topic holds clouds that can be read (PointCloud2 of ROS 1 or 2, "
            f"foxglove.PointCloud); it holds {held}"
        )
    listed = ", ".join(f"{c.topic} ({c.sweeps:,} x {c.points // c.sweeps:,} points)" for c in found)
    if topic and not channels:
        raise StageError(f"{path}: no clouds on [ingest] topic = '{topic}'; they are on {listed}")
    if not with_points:
        raise StageError(f"{path}: the cloud is empty ({listed}); export it again")
    raise StageError(f"{path}: clouds on several topics: {listed}; choose one with [ingest] topic")


def _overview(path: Path) -> Iterator[tuple[list[_Channel], list[str]]]:
    """Topics with clouds; of the others the names with the types of their messages."""
    clouds: dict[str, _Channel] = {}
    others: dict[str, str] = {}
    with readable(path, "MCAP file", _MEND), path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        topics = None
        if summary is not None and summary.channels:
            schemas = summary.schemas
            kinds = [(c, schemas.get(c.schema_id)) for c in summary.channels.values()]
            topics = [c.topic for c, s in kinds if s and decoder(s.name, c.message_encoding)]
            others = {c.topic: s.name if s else "?" for c, s in kinds if c.topic not in topics}
        if topics != []:
            for schema, channel, message in reader.iter_messages(topics, log_time_order=False):
                name, encoding = schema.name if schema else "", channel.message_encoding
                decode = decoder(name, encoding)
                if decode is None:
                    others[channel.topic] = name
                    continue
                cloud = _decoded(decode, message.data, channel.topic)
                fields = cloud.rows.dtype.names or ()
                before = clouds.get(channel.topic)
                clouds[channel.topic] = _Channel(
                    channel.topic,
                    name,
                    encoding,
                    1 + (before.sweeps if before else 0),
                    len(cloud.rows) + (before.points if before else 0),
                    cloud.frame,
                    before.fields if before and before.points else fields,
                )
    yield list(clouds.values()), [f"{topic} ({name})" for topic, name in others.items()]


def _sweeps(path: Path, topic: str) -> Iterator[Sweep]:
    with readable(path, "MCAP file", _MEND), path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages([topic]):
            decode = decoder(schema.name if schema else "", channel.message_encoding)
            if decode is None:
                continue
            cloud = _decoded(decode, message.data, topic)
            T = cloud.T_frame_points
            names = cloud.rows.dtype.names or ()
            times = next((name for name in _TIMES if name in names), None)
            yield Sweep(
                xyz_of(cloud.rows) @ T[:3, :3].T + T[:3, 3],
                colours_of(cloud.rows),
                None if times is None else cloud.rows[times].astype(np.float64),
                min(max(cloud.time_ns or message.log_time, 0), _LATEST_NS),
            )


def _decoded(decode: Decode, data: bytes, topic: str) -> CloudMessage:
    try:
        return decode(data)
    except ValueError as error:
        raise ValueError(f"a message on {topic} is damaged: {error}") from None
