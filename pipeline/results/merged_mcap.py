"""A whole run as one MCAP file that Foxglove and Rerun show without set-up.

Everything is in the frame ``world``; ``candidate`` follows the candidate of the moment. Time is a
story: stage i at 10 i seconds after the epoch, then one candidate a second, the kept ones first.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.boxes import boxes_of
from spinpipe.pipeline.drawing.candidates import SIGHT_COLOURS, WHAT_COLOURS
from spinpipe.pipeline.drawing.closeup import Closeup, closeups
from spinpipe.pipeline.drawing.preview import preview
from spinpipe.pipeline.mcap_file import EPOCH_NS
from spinpipe.pipeline.results.instances import ReadTopic
from spinpipe.schemas import CALIBRATIONS, CAMERAS, CLOUD, CLUSTERS, HITS, TILES, UPRIGHT
from spinpipe.schemas.arrays import F32
from spinpipe.schemas.foxglove_codec import encode_calibration, encode_cameras, point_cloud
from spinpipe.schemas.records import Detection
from spinpipe.stages import STAGES
from spinpipe.stages.geometry.frames import rotation_quaternion, to_world

SECOND_NS = 1_000_000_000
STAGE_S, CANDIDATE_S = 10, 1
PREVIEW_POINTS = 1_000_000
CLOSE_POINTS = 2500
MOST_CANDIDATES = 400


def write_mcap(read: ReadTopic, detections: Sequence[Detection], path: Path) -> None:
    """Write the run: cloud, hits, candidates and detections, then every detection close by.

    Parameters
    ----------
    read : reader of the run.
    detections : those that get boxes, and the best of them a second each.
    path : file to write.
    """
    with path.open("wb") as stream, Writer(stream) as writer:
        story = _Story(writer)
        number = {stage.name: i for i, stage in enumerate(STAGES, 1)}
        upright, tiles = read(UPRIGHT)[0], read(TILES)[0]
        clouds = ((to_world(upright, tile.xyz), tile.rgb) for tile in read(CLOUD))
        pieces = list(preview(clouds, tiles.counts.tolist(), PREVIEW_POINTS))
        story.at(STAGE_S * number["ingest"])
        xyz, rgb = np.concatenate([p.xyz for p in pieces]), np.concatenate([p.rgb for p in pieces])
        story.tell("/cloud", point_cloud("world", xyz, rgb))
        story.tell("/tf", _transform("local", upright.quaternion_xyzw, upright.translation))
        for cameras in read(CAMERAS):
            story.tell("/cameras", encode_cameras(cameras))
        for calibration in read(CALIBRATIONS):
            story.tell("/calibrations", encode_calibration(calibration))
        story.at(STAGE_S * number["scan"])
        hits = [group.points for group in read(HITS)] or [np.empty((0, 3), np.float32)]
        story.tell("/hits", _plain_cloud("world", np.concatenate(hits), palette.HIT))
        story.at(STAGE_S * number["cluster"])
        places = np.array([c.position for c in read(CLUSTERS)], np.float32).reshape(-1, 3)
        story.tell("/candidates", _plain_cloud("world", places, palette.WHITE))
        story.at(STAGE_S * number["verify"])
        story.tell("/detections", _boxes(detections))
        begin = STAGE_S * (number["verify"] + 1)
        ranked = sorted(detections, key=lambda d: (palette.rank(d.fate), -d.score, d.id))
        for i, look in enumerate(closeups(read, ranked[:MOST_CANDIDATES], CLOSE_POINTS)):
            story.at(begin + CANDIDATE_S * i)
            _tell_candidate(story, look)


class _Story:
    """Writes messages at a moment of the story."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._now = EPOCH_NS

    def at(self, seconds: int) -> None:
        """What follows happens so long after the epoch."""
        self._now = EPOCH_NS + seconds * SECOND_NS

    def tell(self, topic: str, message: Any) -> None:
        """Write one message, stamped with the moment."""
        stamp = Timestamp(seconds=self._now // SECOND_NS)
        if isinstance(message, SceneUpdate | FrameTransforms):
            parts = message.entities if isinstance(message, SceneUpdate) else message.transforms
            for part in parts:
                part.timestamp.CopyFrom(stamp)
        else:
            message.timestamp.CopyFrom(stamp)
        self._writer.write_message(
            topic=topic, message=message, log_time=self._now, publish_time=self._now
        )


def _tell_candidate(story: _Story, look: Closeup) -> None:
    d = look.detection
    turn = rotation_quaternion(d.T_world_object).tolist()
    story.tell("/tf", _transform("candidate", turn, d.position_world))
    what, sight = WHAT_COLOURS[look.what], SIGHT_COLOURS[look.sight]
    story.tell("/candidate/points", point_cloud("candidate", look.xyz, what))
    story.tell("/candidate/surface", point_cloud("candidate", look.surface, sight))
    story.tell("/candidate/box", _boxes([d], chosen=True))
    level = Log.Level.INFO if d.fate in palette.KEPT else Log.Level.WARNING
    text = f"candidate {d.id}: {d.model} {d.fate}: {d.reason}"
    story.tell("/candidate/log", Log(level=level, message=text, name="verify"))
    if look.spin.size:
        rows, columns = look.spin.shape
        grey = np.round(255 * look.spin / max(float(look.spin.max()), 1.0)).astype(np.uint8)
        image = RawImage(
            frame_id="candidate", width=columns, height=rows, encoding="mono8", step=columns
        )
        image.data = grey.tobytes()
        story.tell("/candidate/spin_image", image)


def _transform(child: str, quaternion_xyzw: Sequence[float], place: Sequence[float]) -> Message:
    message = FrameTransform(parent_frame_id="world", child_frame_id=child)
    r, t = message.rotation, message.translation
    r.x, r.y, r.z, r.w = quaternion_xyzw
    t.x, t.y, t.z = place
    return message


def _plain_cloud(frame: str, xyz: F32, colour: palette.Colour) -> PointCloud:
    return point_cloud(frame, xyz, np.tile(np.array(colour[:3], np.uint8), (len(xyz), 1)))


def _boxes(detections: Sequence[Detection], *, chosen: bool = False) -> SceneUpdate:
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
