"""A whole run as one MCAP file that Foxglove and Rerun show without set-up.

Everything is in the frame ``world``; ``candidate`` follows the candidate of the moment. Time is a
story: stage i at 10 i seconds after the epoch, then one candidate a second, the kept ones first.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap_protobuf.writer import Writer

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.candidates import SIGHT_COLOURS, WHAT_COLOURS
from spinpipe.pipeline.drawing.closeup import Closeup, closeups
from spinpipe.pipeline.drawing.preview import preview
from spinpipe.pipeline.mcap_file import EPOCH_NS, SECOND_NS, STAGE_S, stamp
from spinpipe.pipeline.results.instances import ReadTopic
from spinpipe.pipeline.views import boxes_update, frame_transform, plain_cloud, reason_log
from spinpipe.schemas import CALIBRATIONS, CAMERAS, CLOUD, CLUSTERS, HITS, TILES, UPRIGHT
from spinpipe.schemas.foxglove_codec import encode_calibration, encode_cameras, point_cloud
from spinpipe.schemas.records import Detection
from spinpipe.stages import STAGES
from spinpipe.stages.geometry.frames import rotation_quaternion, to_world

CANDIDATE_S = 1
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
        story.tell("/tf", frame_transform("local", upright.quaternion_xyzw, upright.translation))
        for cameras in read(CAMERAS):
            story.tell("/cameras", encode_cameras(cameras))
        for calibration in read(CALIBRATIONS):
            story.tell("/calibrations", encode_calibration(calibration))
        story.at(STAGE_S * number["scan"])
        hits = [group.points for group in read(HITS)] or [np.empty((0, 3), np.float32)]
        story.tell("/hits", plain_cloud(np.concatenate(hits), palette.HIT))
        story.at(STAGE_S * number["cluster"])
        places = np.array([c.position for c in read(CLUSTERS)], np.float32).reshape(-1, 3)
        story.tell("/candidates", plain_cloud(places, palette.WHITE))
        story.at(STAGE_S * number["verify"])
        story.tell("/detections", boxes_update(detections))
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
        stamp(message, self._now)
        self._writer.write_message(
            topic=topic, message=message, log_time=self._now, publish_time=self._now
        )


def _tell_candidate(story: _Story, look: Closeup) -> None:
    d = look.detection
    turn = rotation_quaternion(d.T_world_object).tolist()
    story.tell("/tf", frame_transform("candidate", turn, d.position_world))
    what, sight = WHAT_COLOURS[look.what], SIGHT_COLOURS[look.sight]
    story.tell("/candidate/points", point_cloud("candidate", look.xyz, what))
    story.tell("/candidate/surface", point_cloud("candidate", look.surface, sight))
    story.tell("/candidate/box", boxes_update([d], chosen=True))
    story.tell("/candidate/log", reason_log(d))
    if look.spin.size:
        rows, columns = look.spin.shape
        grey = np.round(255 * look.spin / max(float(look.spin.max()), 1.0)).astype(np.uint8)
        image = RawImage(
            frame_id="candidate", width=columns, height=rows, encoding="mono8", step=columns
        )
        image.data = grey.tobytes()
        story.tell("/candidate/spin_image", image)
