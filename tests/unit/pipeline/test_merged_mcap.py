"""The merged MCAP file: any reader decodes it, and its times tell the run in order."""

from __future__ import annotations

import json
import subprocess
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

from spinpipe.pipeline.drawing.recording import find_viewer

if TYPE_CHECKING:
    from tests.conftest import Cli, YardRun


@pytest.fixture(scope="module")
def merged(finished_yard: YardRun, tmp_path_factory: pytest.TempPathFactory, cli: Cli) -> Path:
    path = tmp_path_factory.mktemp("merged") / "yard.mcap"
    fates = "accepted,ambiguous,duplicate,rejected"
    outcome = cli("export", finished_yard.output, "-f", "mcap", "--fate", fates, "-o", path)
    assert outcome.code == 0, outcome.err
    return path


def messages(path: Path) -> dict[str, list[tuple[int, str, Any]]]:
    """Time, schema and message of each topic, by a reader that knows none of our types."""
    found: dict[str, list[tuple[int, str, Any]]] = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None
            found[channel.topic].append((message.log_time, schema.name, decoded))
    return found


def test_everything_is_foxglove_s_and_drawn(merged: Path, finished_yard: YardRun) -> None:
    found = messages(merged)
    schemas = {name.removeprefix("foxglove.") for rows in found.values() for _, name, _ in rows}
    assert schemas <= {"PointCloud", "SceneUpdate", "FrameTransform", "Log", "RawImage"}
    update = found["/detections"][0][2]
    by_id = {d["id"]: d for d in finished_yard.detections()}
    assert {int(entity.id) for entity in update.entities} == set(by_id)
    for entity in update.entities:
        d = by_id[int(entity.id)]
        cube = entity.cubes[0]
        place, o = cube.pose.position, cube.pose.orientation
        turn = Rotation.from_quat([o.x, o.y, o.z, o.w])
        assert turn.approx_equal(Rotation.from_quat(d["quaternion_xyzw"]), atol=1e-9)
        base = [place.x, place.y, place.z] - turn.apply([0, 0, d["size_m"][2] / 2])
        np.testing.assert_allclose(base, d["position_world"], atol=1e-9)
        np.testing.assert_allclose([cube.size.x, cube.size.y, cube.size.z], d["size_m"])
        assert {m.key: m.value for m in entity.metadata}["reason"] == d["reason"]
        assert bool(entity.texts) == (d["fate"] in ("accepted", "ambiguous"))


def test_time_goes_by_stages_then_by_candidates(merged: Path, finished_yard: YardRun) -> None:
    found = messages(merged)
    order = [found[topic][0][0] for topic in ("/cloud", "/hits", "/candidates", "/detections")]
    assert order == sorted(order)
    assert min(np.diff(order)) >= 5e9  # seconds to look at each
    told = found["/candidate/log"]
    assert len(told) == len(finished_yard.detections())
    assert set(np.diff([time for time, _, _ in told])) == {1_000_000_000}
    assert told[0][0] > order[-1]
    assert "accepted" in told[0][2].message
    for time, _, log in told:
        assert log.timestamp.seconds == time // 10**9


def test_rerun_finds_nothing_wrong(merged: Path) -> None:
    viewer = find_viewer()
    assert viewer is not None
    subprocess.run([viewer, "mcap", "check", str(merged)], check=True, capture_output=True)


def test_the_layout_shows_topics_that_are_there(merged: Path) -> None:
    layout = Path(__file__).parents[3] / "docs" / "foxglove-layout.json"
    panels = json.loads(layout.read_text())["configById"]
    topics = {topic for panel in panels.values() for topic in panel.get("topics", {})}
    topics |= {p["imageMode"]["imageTopic"] for p in panels.values() if "imageMode" in p}
    topics |= {p["topicToRender"] for p in panels.values() if "topicToRender" in p}
    assert topics
    assert topics <= set(messages(merged))
