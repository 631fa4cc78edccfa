"""Each stage's file alone: any reader decodes it, something is in place, seconds make sense."""

from __future__ import annotations

import subprocess
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from spinpipe.pipeline.drawing.recording import find_viewer
from spinpipe.pipeline.mcap_file import EPOCH_NS
from spinpipe.stages import STAGES

if TYPE_CHECKING:
    from tests.conftest import YardRun

Found = dict[str, list[tuple[float, Any]]]
every_stage = pytest.mark.parametrize("stage", [stage.name for stage in STAGES])


def decoded(path: Path) -> Found:
    """Seconds after the epoch and message by topic, by a reader that knows none of our types."""
    found: Found = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages():
            found[channel.topic].append(((message.log_time - EPOCH_NS) / 1e9, content))
    return found


def xyz(cloud: Any) -> np.ndarray:
    """(N, 3) coordinates of a point cloud."""
    rows = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_stride)
    return rows[:, :12].copy().view("<f4")


@every_stage
def test_a_stage_s_file_shows_something_alone(finished_yard: YardRun, stage: str) -> None:
    found = decoded(finished_yard.mcap(stage))
    begin = 10 * (1 + [s.name for s in STAGES].index(stage))
    clouds = {t: rows for t, rows in found.items() if t.startswith(f"/{stage}/view/")}
    points = [xyz(m) for rows in clouds.values() for _, m in rows if hasattr(m, "point_stride")]
    assert sum(map(len, points)) > 100
    for topic, rows in found.items():
        seconds = [second for second, _ in rows]
        assert seconds[0] == begin, topic
        assert set(np.diff(seconds)) <= {1.0}, topic
        if topic in clouds:
            for second, message in rows:
                stamps = [e.timestamp for e in getattr(message, "entities", [message])]
                assert {s.seconds for s in stamps} == {EPOCH_NS // 10**9 + int(second)}


def test_models_and_boxes_stand_on_the_cloud(finished_yard: YardRun) -> None:
    found = decoded(finished_yard.mcap("verify"))
    detections = finished_yard.detections()
    ((_, boxes),) = found["/verify/view/boxes"]
    assert [int(entity.id) for entity in boxes.entities] == [d["id"] for d in detections]
    models = xyz(found["/verify/view/models"][0][1])
    cloud = xyz(found["/verify/view/cloud"][0][1])
    assert len(models) > 300
    for d in detections:
        if d["fate"] == "accepted":
            for points in (models, cloud):
                away = np.linalg.norm(points[:, :2] - d["position_world"][:2], axis=1)
                assert (away < 1.0).sum() > 50
    told = [message.message for _, message in found["/verify/view/log"]]
    assert all(d["reason"] in text for d, text in zip(detections, told, strict=True))


@every_stage
def test_rerun_finds_nothing_wrong(finished_yard: YardRun, stage: str) -> None:
    viewer = find_viewer()
    assert viewer is not None
    path = str(finished_yard.mcap(stage))
    subprocess.run([viewer, "mcap", "check", path], check=True, capture_output=True)
