"""Every stage is drawn from made-up messages, and the recording is read back."""

from __future__ import annotations

import re
import subprocess
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from rerun.chunk import RrdReader
from tests.unit.pipeline.drawn import (
    FATES,
    STAGES,
    Messages,
    chunks,
    column,
    draw,
    make_detection,
    make_model,
    make_run,
)

from spinpipe.pipeline.drawing.draw import DRAW
from spinpipe.pipeline.drawing.drawing import STAGE_NUMBER
from spinpipe.pipeline.drawing.recording import (
    find_viewer,
)
from spinpipe.schemas import (
    CAMERAS,
    CLUSTERS,
    DETECTIONS,
    HITS,
    MODELS,
    SCENE,
    SCORES,
    SPIN_IMAGES,
    TRACES,
)

pytestmark = pytest.mark.usefixtures("strict")


def test_every_stage_has_a_drawing() -> None:
    assert list(DRAW) == list(STAGES)


def test_entities_are_named_after_stages_and_topics(recording: Path) -> None:
    paths = set(RrdReader(recording).store().schema().entity_paths())
    assert {
        "/ingest/cloud/0000",
        "/ingest/cameras",
        "/ingest/trajectory",
        "/ground/plane",
        "/scan/correlation/0002",
        "/scan/hits/saloon",
        "/scan/histogram/van",
        "/scan/spin_image/saloon/scene",
        "/cluster/candidates",
        "/cluster/candidate",
        *(f"/verify/{fate}" for fate in FATES),
        "/verify/fit/saloon",
        "/candidate/registration/residuals",
        "/verify/ledger",
        "/notes",
    } <= paths


def test_only_timelines_that_are_not_time(recording: Path) -> None:
    names = {str(index.name) for index in RrdReader(recording).store().schema().index_columns()}
    # three tiles are too few steps for a timeline of their own
    assert names == {"stage", "candidate", "threshold"}


def test_file_is_sound(recording: Path) -> None:
    viewer = find_viewer()
    assert viewer is not None
    subprocess.run([viewer, "rrd", "verify", str(recording)], check=True, capture_output=True)


def test_cloud_is_static_in_the_local_frame_and_turns_upright_with_the_stage(
    recording: Path,
) -> None:
    cloud = chunks(recording, "/ingest/cloud/**")
    assert all(chunk.is_static for chunk in cloud)
    assert column(cloud, "CoordinateFrame:frame") == [["local"]] * 3
    assert sum(len(row) for row in column(cloud, "Points3D:positions")) == 1000
    local = chunks(recording, "/frames/local")
    assert column(local, "stage") == [STAGE_NUMBER["ingest"], STAGE_NUMBER["ground"]]
    assert column(local, "Transform3D:quaternion") == [[pytest.approx([0.6, 0, 0, 0.8])]]


@pytest.mark.parametrize("timeline", ["candidate"])
@pytest.mark.parametrize(
    "path",
    ["/frames/local", "/frames/candidate", "/scan/spin_image/saloon/model", "/verify/accepted"],
)
def test_results_are_there_from_the_start_of_every_timeline(
    recording: Path, path: str, timeline: str
) -> None:
    assert min(column(chunks(recording, path, static=False), timeline)) == 0


def test_all_shapes_hang_in_one_tree_of_frames(recording: Path) -> None:
    shapes = ("Points3D:positions", "Boxes3D:half_sizes", "LineStrips3D:strips", "Mesh3D:vertex")
    found = [c for c in chunks(recording, "/**") if not c.entity_path.startswith("/model/objects")]
    placed = {c.entity_path for c in found if column([c], "CoordinateFrame:frame")}
    drawn = {
        c.entity_path
        for c in found
        if any(name.startswith(shapes) for name in c.to_record_batch().schema.names)
    }
    assert drawn
    assert drawn <= placed


def test_many_tiles_appear_one_after_the_other(tmp_path: Path) -> None:
    run = make_run()
    tiles = [*run(SCORES), *run(SCORES)]
    path = draw(tmp_path / "run.rrd", run.with_messages(SCORES, tiles))
    steps = [
        column(chunks(path, f"/scan/correlation/{i:04d}", static=False), "tile") for i in range(6)
    ]
    assert steps == [[i] for i in range(6)]


def test_interim_results_are_cleared_by_later_stages(recording: Path) -> None:
    for path, first, cleared in (
        ("/ground", "ground", "scan"),
        ("/scan/hits", "scan", "verify"),
        ("/cluster/candidates", "cluster", "verify"),
    ):
        below = chunks(recording, f"{path}/**", static=False)
        assert {tuple(chunk.timeline_names) for chunk in below} == {("stage",)}
        assert set(column(below, "stage")) == {STAGE_NUMBER[first], STAGE_NUMBER[cleared]}


def test_the_cloud_has_a_second_colouring_by_height(recording: Path) -> None:
    cloud = chunks(recording, "/ingest/cloud/**")
    assert sum(len(row) for row in column(cloud, "Height:colors")) == 1000


def test_preview_caps_cloud_and_correlation(tmp_path: Path) -> None:
    path = draw(tmp_path / "run.rrd", make_run(), points=100)
    for content in ("/ingest/cloud/**", "/scan/correlation/**"):
        assert sum(len(row) for row in column(chunks(path, content), "Points3D:positions")) == 100


def test_the_same_messages_draw_the_same_recording(tmp_path: Path) -> None:
    first, second = (draw(tmp_path / name, make_run()) for name in ("a.rrd", "b.rrd"))
    assert rows_by_kind(first) == rows_by_kind(second)


def rows_by_kind(path: Path) -> Counter[str]:
    """How many rows there are of each entity, timelines and columns, however chunks were cut."""
    rows: Counter[str] = Counter()
    for line in str(RrdReader(path).store().summary()).splitlines():
        found = re.fullmatch(r"(\S+) rows=(\d+) (.*)", line)
        if found and "RecordingInfo" not in line:
            rows[f"{found[1]} {found[3]}"] += int(found[2])
    assert rows
    return rows


@pytest.mark.parametrize("until", range(1, 6))
def test_a_run_that_stopped_early_can_be_looked_at(tmp_path: Path, until: int) -> None:
    path = draw(tmp_path / "run.rrd", make_run(), STAGES[:until])
    assert max(column(chunks(path, "/notes"), "stage")) == until


@pytest.mark.parametrize(
    "run",
    [
        make_run()
        .with_messages(HITS, [])
        .with_messages(CLUSTERS, [])
        .with_messages(TRACES, [])
        .with_messages(DETECTIONS, []),
        make_run().with_messages(CAMERAS, []).with_messages(SPIN_IMAGES, []),
        make_run().with_messages(TRACES, []),
        make_run().with_messages(SCENE, [replace(make_run()(SCENE)[0], coloured=False)]),
        make_run()
        .with_messages(MODELS, [make_model("van/of: two words", mesh=True)])
        .with_messages(DETECTIONS, [make_detection(0, "van/of: two words", "accepted")]),
    ],
    ids=["nothing found", "no cameras", "no traces", "no colours", "a name full of signs"],
)
def test_sparse_runs_are_drawn(tmp_path: Path, run: Messages) -> None:
    path = draw(tmp_path / "run.rrd", run)
    assert max(column(chunks(path, "/notes"), "stage")) == len(STAGES)
