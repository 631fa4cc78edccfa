"""What a viewer shows of a stage's file when it is opened alone.

Records are made for the stages that read them: a cloud comes in tiles, a detection is a row of
numbers. Beside them each file holds topics ``/<stage>/view/...`` in Foxglove's messages: the
thinned cloud in one piece, hits and candidates as points, boxes coloured by fate with labels, the
surface of every kept model as points (Rerun draws no boxes of Foxglove's), and candidate by
candidate, one a second, its box and the reason for its fate.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.boxes import boxes_of
from spinpipe.pipeline.mcap_file import Messages
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import CLOUD, CLUSTERS, DETECTIONS, HITS, MODELS, SCORES, UPRIGHT
from spinpipe.schemas.arrays import F32, U8
from spinpipe.schemas.foxglove_codec import decode_tile, encode_tile, point_cloud
from spinpipe.schemas.records import (
    CloudTile,
    Cluster,
    Detection,
    ObjectModel,
    ScoreTile,
)
from spinpipe.schemas.topics import Topic
from spinpipe.stages.geometry.frames import rotation_quaternion, to_world, transform

OVERVIEW = Topic("/ingest/view/cloud", PointCloud, encode_tile, decode_tile)
"""The thinned cloud; later stages show theirs over it."""
MOST_POINTS = 100_000
MODEL_POINTS = 400
"""Of each fitted model."""
SHOWN_TOPICS = {t.name for t in (CLOUD, MODELS, SCORES, HITS, CLUSTERS, DETECTIONS)}

View = tuple[str, int, Message]
"""Topic, seconds after the stage's beginning, message."""


class StageViews:
    """Looks on while a stage writes, and tells at its end what viewers get.

    Parameters
    ----------
    stage : its name.
    folder : of the run, where the files of earlier stages are.
    """

    def __init__(self, stage: str, folder: RunFolder) -> None:
        self._stage = stage
        self._folder = folder
        self._cloud = _Thinned()
        self._seen: list[Any] = []

    def see(self, topic: Topic[Any], record: Any) -> None:
        """Take note of a record that the stage wrote."""
        if topic.name not in SHOWN_TOPICS:
            return
        if isinstance(record, CloudTile):
            self._cloud.add(record.xyz, record.rgb)
        elif isinstance(record, ScoreTile):
            self._cloud.add(record.points, record.rgb)
        else:
            self._seen.append(record)

    def messages(self) -> Iterator[View]:
        """All views of the stage."""
        shown = f"/{self._stage}/view"
        seen = self._seen
        if self._stage == "ingest":
            yield OVERVIEW.name, 0, point_cloud("local", *self._cloud.points())
        elif self._stage == "model":
            yield from _models(shown, seen)
        elif self._stage == "ground":
            for tile in self._overview():
                yield f"{shown}/cloud", 0, encode_tile(tile)
        elif self._stage == "scan":
            yield f"{shown}/correlation", 0, point_cloud("world", *self._cloud.points())
            hits = [group.points for group in seen]
            yield f"{shown}/hits", 0, plain_cloud(_joined(hits), palette.HIT)
        elif self._stage == "cluster":
            yield from self._context(shown)
            yield from _candidates(shown, seen)
        elif self._stage == "verify":
            yield from self._context(shown)
            models = {m.name: m for m in Messages(self._folder.mcap("model"), MODELS)}
            yield from _detections(shown, seen, models)

    def _overview(self) -> Sequence[CloudTile]:
        return Messages(self._folder.mcap("ingest"), OVERVIEW)

    def _context(self, shown: str) -> Iterator[View]:
        """The cloud in the world, around what the stage found."""
        for upright in Messages(self._folder.mcap("ground"), UPRIGHT):
            for tile in self._overview():
                cloud = point_cloud("world", to_world(upright, tile.xyz), tile.rgb)
                yield f"{shown}/cloud", 0, cloud


class _Thinned:
    """Every k-th of the points that come, k doubled when they are too many."""

    def __init__(self) -> None:
        self._xyz, self._rgb = [np.empty((0, 3), np.float32)], [np.empty((0, 3), np.uint8)]
        self._step = 1
        self._came = self._kept = 0

    def add(self, xyz: F32, rgb: U8) -> None:
        """Take more points (N, 3) and their colours (N, 3)."""
        rows = slice(-self._came % self._step, None, self._step)
        self._came += len(xyz)
        self._xyz.append(xyz[rows])
        self._rgb.append(rgb[rows])
        self._kept += len(self._xyz[-1])
        while self._kept > 2 * MOST_POINTS:
            self._step *= 2
            self._xyz = [np.concatenate(self._xyz)[::2]]
            self._rgb = [np.concatenate(self._rgb)[::2]]
            self._kept = len(self._xyz[0])

    def points(self) -> tuple[F32, U8]:
        """What was kept: points (N, 3) and colours (N, 3), fewer than twice ``MOST_POINTS``."""
        return np.concatenate(self._xyz), np.concatenate(self._rgb)


def _models(shown: str, models: Sequence[ObjectModel]) -> Iterator[View]:
    """All models side by side along y, with their names."""
    points, names = [np.empty((0, 3), np.float32)], SceneUpdate()
    y = 0.0
    for model in models:
        width = 1.4 * float(model.size[1])
        points.append(model.points + np.array([0, y + width / 2, 0], np.float32))
        entity = names.entities.add(frame_id="object", id=model.name)
        text = entity.texts.add(text=model.name, billboard=True, font_size=0.2 * model.size[2])
        place = text.pose.position
        place.x, place.y, place.z = 0.0, y + width / 2, 1.2 * float(model.size[2])
        text.pose.orientation.w = 1.0
        _paint(text.color, palette.WHITE)
        y += width
    cloud = _joined(points)
    yield f"{shown}/points", 0, point_cloud("object", cloud, _colours(cloud, palette.MARK))
    yield f"{shown}/names", 0, names


def _candidates(shown: str, clusters: Sequence[Cluster]) -> Iterator[View]:
    places = np.array([c.position for c in clusters], np.float32).reshape(-1, 3)
    yield f"{shown}/points", 0, plain_cloud(places, palette.WHITE)
    update = SceneUpdate()
    for cluster in clusters:
        entity = update.entities.add(frame_id="world", id=str(cluster.id))
        text = entity.texts.add(
            text=f"{cluster.id}: {cluster.correlation:.2f}",
            billboard=True,
            scale_invariant=True,
            font_size=12,
        )
        place = text.pose.position
        place.x, place.y, place.z = cluster.position
        text.pose.orientation.w = 1.0
        _paint(text.color, palette.WHITE)
    yield f"{shown}/labels", 0, update


def _detections(
    shown: str, detections: Sequence[Detection], models: dict[str, ObjectModel]
) -> Iterator[View]:
    """All boxes and models at once, then candidate by candidate."""
    yield f"{shown}/boxes", 0, boxes_update(detections)
    points, colours = [np.empty((0, 3), np.float32)], [np.empty((0, 3), np.uint8)]
    for d in detections:
        if d.fate in palette.KEPT:
            model = models[d.model].points
            part = model[:: max(1, len(model) // MODEL_POINTS)]
            points.append(transform(d.T_world_object, part).astype(np.float32))
            colours.append(_colours(part, palette.fate_colour(d.fate)))
    yield f"{shown}/models", 0, point_cloud("world", _joined(points), np.concatenate(colours))
    for second, d in enumerate(detections):
        turn = rotation_quaternion(d.T_world_object).tolist()
        yield f"{shown}/tf", second, frame_transform("candidate", turn, d.position_world)
        yield f"{shown}/candidate", second, boxes_update([d], chosen=True)
        yield f"{shown}/log", second, reason_log(d)


def reason_log(d: Detection) -> Log:
    """Fate and reason of a detection."""
    level = Log.Level.INFO if d.fate in palette.KEPT else Log.Level.WARNING
    text = f"candidate {d.id}: {d.model} {d.fate}: {d.reason}"
    return Log(level=level, message=text, name="verify")


def _joined(parts: Sequence[F32]) -> F32:
    return np.concatenate([np.empty((0, 3), np.float32), *parts])


def _colours(xyz: F32, colour: palette.Colour) -> U8:
    return np.tile(np.array(colour[:3], np.uint8), (len(xyz), 1))


def _paint(target: Color, colour: palette.Colour) -> None:
    target.r, target.g, target.b, target.a = (*(c / 255 for c in colour[:3]), 1.0)


def frame_transform(
    child: str, quaternion_xyzw: Sequence[float], place: Sequence[float]
) -> FrameTransform:
    """Pose of a frame in the world."""
    message = FrameTransform(parent_frame_id="world", child_frame_id=child)
    r, t = message.rotation, message.translation
    r.x, r.y, r.z, r.w = quaternion_xyzw
    t.x, t.y, t.z = place
    return message


def plain_cloud(xyz: F32, colour: palette.Colour) -> PointCloud:
    """Points (N, 3) of one colour in the world."""
    return point_cloud("world", xyz, _colours(xyz, colour))


def boxes_update(detections: Sequence[Detection], *, chosen: bool = False) -> SceneUpdate:
    """A cube, an arrow ahead and a label for each; the numbers as metadata."""
    update = SceneUpdate()
    boxes = boxes_of(detections)
    for d, centre, top, turn in zip(
        detections, boxes.centers, boxes.tops, boxes.quaternions, strict=True
    ):
        entity = update.entities.add(frame_id="world", id="chosen" if chosen else str(d.id))
        red, green, blue = (c / 255 for c in palette.fate_colour(d.fate)[:3])
        cube = entity.cubes.add()
        place, o = cube.pose.position, cube.pose.orientation
        place.x, place.y, place.z = centre
        o.x, o.y, o.z, o.w = turn
        cube.size.x, cube.size.y, cube.size.z = d.size_m
        c = cube.color
        c.r, c.g, c.b, c.a = red, green, blue, 0.45 if d.fate in palette.KEPT else 0.12
        if d.fate in palette.KEPT or chosen:
            arrow = entity.arrows.add(
                shaft_length=0.5 * d.size_m[0],
                shaft_diameter=0.08 * d.size_m[1],
                head_length=0.2 * d.size_m[0],
                head_diameter=0.2 * d.size_m[1],
            )
            arrow.pose.CopyFrom(cube.pose)
            place = arrow.pose.position
            place.x, place.y, place.z = top
            arrow.color.r, arrow.color.g, arrow.color.b, arrow.color.a = red, green, blue, 1.0
            label = entity.texts.add(
                text=f"{d.id} {d.model} {d.score:.2f}",
                billboard=True,
                font_size=0.35 * d.size_m[2],
            )
            label.pose.CopyFrom(arrow.pose)
            label.pose.position.z += 0.4 * d.size_m[2]
            label.color.r, label.color.g, label.color.b, label.color.a = red, green, blue, 1.0
        for key in ("id", "model", "fate", "reason", "score", "rms_m"):
            entity.metadata.add(key=key, value=str(getattr(d, key)))
    return update
