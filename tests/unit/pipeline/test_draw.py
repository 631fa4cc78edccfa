"""Every stage is drawn from made-up messages, and the recording is read back."""

from __future__ import annotations

import io
import re
import subprocess
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr
from PIL import Image
from rerun.chunk import Chunk, RrdReader
from scipy.spatial.transform import Rotation

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.draw import DRAW
from spinpipe.pipeline.drawing.drawing import STAGE_NUMBER
from spinpipe.pipeline.drawing.parts import LENGTH
from spinpipe.pipeline.drawing.photos import Photo
from spinpipe.pipeline.drawing.recording import (
    close_recording,
    find_viewer,
    open_recording,
    record_stage,
)
from spinpipe.pipeline.drawing.threshold import Truth
from spinpipe.schemas import (
    CALIBRATIONS,
    CAMERAS,
    CLOUD,
    CLUSTERS,
    DETECTIONS,
    HITS,
    MODELS,
    PLANE,
    SAMPLING,
    SCENE,
    SCORES,
    SPIN_IMAGES,
    TILES,
    TRACES,
    TRAJECTORY,
    UPRIGHT,
)
from spinpipe.schemas.records import (
    Calibration,
    Cameras,
    CloudTile,
    Cluster,
    Detection,
    Evidence,
    FitTrace,
    Hits,
    ObjectModel,
    Part,
    Plane,
    Sampling,
    SceneFrame,
    ScoreTile,
    SpinImage,
    TileIndex,
    Trajectory,
    Upright,
)
from spinpipe.schemas.topics import Topic

T = TypeVar("T")

STAGES = tuple(STAGE_NUMBER)
ITERATIONS, STARTS = 4, 3
FATES = ("accepted", "ambiguous", "rejected")


class Messages:
    """A run held in memory."""

    def __init__(self, of: dict[Topic[Any], list[Any]]) -> None:
        self.of = {topic.name: messages for topic, messages in of.items()}

    def __call__(self, topic: Topic[T], /) -> Sequence[T]:
        return self.of.get(topic.name, [])

    def with_messages(self, topic: Topic[T], messages: Sequence[T]) -> Messages:
        """The same run with other messages on one topic."""
        other = Messages({})
        other.of = {**self.of, topic.name: list(messages)}
        return other


def make_model(name: str, mesh: bool) -> ObjectModel:
    rng = np.random.default_rng(7)
    corners = np.array([[-2, -1, 0], [2, -1, 0], [2, 1, 0], [0, 0, 1.5]], np.float32)
    return ObjectModel(
        name=name,
        points=rng.uniform([-2, -1, 0], [2, 1, 1.5], (300, 3)).astype(np.float32),
        normals=np.zeros((300, 3), np.float32),
        vertices=corners if mesh else np.zeros((0, 3), np.float32),
        faces=np.array([[0, 1, 3], [1, 2, 3]] if mesh else np.zeros((0, 3)), np.int32),
        T_object_model=np.eye(4),
        visible_from="above",
    )


def make_detection(number: int, model: str, fate: str) -> Detection:
    T_world_object = np.eye(4)
    T_world_object[:3, 3] = (number, -number, 0)
    return Detection(
        id=number,
        cluster=number,
        model=model,
        fate=fate,
        reason=f"{fate} for a reason",
        T_world_object=T_world_object,
        T_scene_model=T_world_object,
        position_world=(float(number), -float(number), 0.0),
        position_scene=(float(number), -float(number), 0.0),
        heading_deg=30.0 * number,
        heading_margin=0.4,
        correlation=0.8,
        rms_m=0.09,
        inliers=400,
        runner_up_heading_deg=180.0,
        runner_up_rms_m=0.13,
        coverage_model=0.7,
        coverage_scene=0.6,
        observed=0.9,
        score=0.5 + 0.1 * number,
        parts=(Part("residual", 0.25, 0.8, -3.5), Part("model", 0.9, 0.9, 0.0)),
        gate_m=0.2,
        sharp_m=0.1,
        alternative="van",
        alternative_margin=0.2,
        size_m=(4.0, 2.0, 1.5),
    )


def make_run() -> Messages:
    """Three tiles, a mesh and a cloud as models, a candidate of every fate."""
    rng = np.random.default_rng(1)
    clouds = [
        CloudTile(
            rng.uniform((10 * i, 0, 0), (10 * i + 10, 8, 2), (count, 3)).astype(np.float32),
            rng.integers(0, 255, (count, 3), np.uint8),
        )
        for i, count in enumerate((500, 20, 480))
    ]
    scores = [
        ScoreTile(
            ("saloon", "van"),
            tile.xyz,
            rng.uniform(-1, 1, (len(tile.xyz), 2)).astype(np.float32),
            tile.rgb,
        )
        for tile in clouds
    ]
    image = SpinImage(
        "saloon", "model", 2.5, 1.0, 0.5, np.ones((2, 5), np.float32), (0, 0, 1.5), 1.0
    )
    rms = np.linspace(0.5, 0.1, STARTS * ITERATIONS, dtype=np.float32)
    trace = FitTrace(
        cluster=0,
        start_heading_deg=np.array([0.0, 120.0, 240.0]),
        rms_m=rms.reshape(ITERATIONS, STARTS).T.copy(),
        poses=np.tile(np.eye(4), (ITERATIONS, 1, 1)),
    )
    trace.rms_m[1, 2:] = np.nan
    hits = Hits("saloon", clouds[0].xyz[:30], np.full(30, 0.9, np.float32))
    return Messages(
        {
            SCENE: [SceneFrame((1e6, 2e6, 0.0), (1.0, 1.0, 1.0), 1000, 3, True, "yard.ply")],
            TILES: [
                TileIndex(
                    np.array([tile.xyz.min(axis=0) for tile in clouds]),
                    np.array([tile.xyz.max(axis=0) for tile in clouds]),
                    np.array([len(tile.xyz) for tile in clouds]),
                )
            ],
            CLOUD: clouds,
            CAMERAS: [Cameras(np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), ("a", "b"))],
            CALIBRATIONS: [],
            TRAJECTORY: [
                Trajectory(
                    np.array([[0.0, 0, 0], [1, 0, 0]]),
                    np.tile([0.0, 0, 0, 1], (2, 1)),
                    np.array([0, 1]),
                )
            ],
            MODELS: [make_model("saloon", mesh=True), make_model("van", mesh=False)],
            PLANE: [Plane((0, 0, 1), 0.0, 900, 1000, 0.03, 0.1, "cameras", (Evidence("c", 1.0),))],
            SAMPLING: [Sampling(0.1, 0.02)],
            UPRIGHT: [Upright((0.6, 0.0, 0.0, 0.8), (0.0, 0.0, 1.0))],
            SCORES: scores,
            HITS: [hits, replace(hits, model="van", points=hits.points[:0])],
            SPIN_IMAGES: [image, replace(image, role="scene", correlation=0.93)],
            CLUSTERS: [Cluster(i, "saloon", (i, 0, 1), 5, 0.8, "delaunay") for i in range(3)],
            TRACES: [trace, replace(trace, cluster=2)],
            DETECTIONS: [
                make_detection(0, "saloon", "accepted"),
                make_detection(1, "van", "ambiguous"),
                make_detection(2, "saloon", "rejected"),
            ],
        }
    )


def draw(path: Path, run: Messages, stages: Sequence[str] = STAGES, points: int = 1000) -> Path:
    rec = open_recording("test", "save", path)
    assert rec is not None
    for stage in stages:
        record_stage(stage, run, rec, points)
    close_recording(rec, path)
    return path


def chunks(path: Path, content: str, static: bool | None = None) -> list[Chunk]:
    """Chunks below a path, in the order in which their first rows were logged."""
    found = RrdReader(path).store().stream().filter(content=content, is_static=static)
    return sorted(found, key=lambda chunk: column([chunk], "rerun.controls.RowId")[0])


def column(found: Sequence[Chunk], name: str) -> list[Any]:
    """All rows of a column, over the chunks that have it."""
    batches = [pa.record_batch(chunk.to_record_batch()) for chunk in found]
    return [row for b in batches if name in b.schema.names for row in b.column(name).to_pylist()]


@pytest.fixture(scope="module", autouse=True)
def strict() -> Iterator[None]:
    """Misuse of the SDK is an error instead of a warning."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def recording(strict: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return draw(tmp_path_factory.mktemp("recording") / "run.rrd", make_run())


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
        "/verify/rms/starts",
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


def test_a_candidate_is_joined_with_the_steps_of_its_registration(recording: Path) -> None:
    saloon = chunks(recording, "/verify/fit/saloon", static=False)
    moves = [c for c in saloon if c.timeline_names == ["candidate"]]
    steps = sorted(set(column(moves, "candidate")))
    # candidates 0 and 2 were traced, 1 shows its reported pose only, as another model
    walked = range(ITERATIONS + 2)
    assert steps == [*walked, 1000, *(2000 + i for i in walked)]
    rms = chunks(recording, "/verify/rms/starts", static=False)
    assert column(rms, "candidate") == [i for i in steps if i != 1000]
    assert all(len(row) == STARTS for row in column(rms, "Scalars:scalars"))


def test_every_candidate_has_its_surroundings_explained(recording: Path) -> None:
    steps = [0, 1000, 2000]
    for path in ("points", "surface", "box", "runner_up", "next_model"):
        found = chunks(recording, f"/candidate/{path}", static=False)
        assert [s for s in column(found, "candidate") if s is not None] == steps
        assert column(found, "stage") == [STAGE_NUMBER["verify"]]  # of the best
    sight = column(chunks(recording, "/candidate/surface"), "Points3D:colors")
    points = column(chunks(recording, "/candidate/points"), "Points3D:positions")
    assert all(len(row) for row in sight)
    assert any(len(row) for row in points)
    outline = chunks(recording, "/candidate/runner_up", static=False)
    sizes = np.array(column(outline, "Boxes3D:half_sizes")[-3:])
    assert sizes.shape == (3, 1, 3)


def test_parts_stand_beside_those_of_a_right_instance(recording: Path) -> None:
    bars = column(chunks(recording, "/candidate/parts/bars"), "LineStrips2D:strips")
    track, bar, mark = np.array(bars[-1])[:3]
    assert track[:, 0].tolist() == [0, LENGTH]
    assert bar[:, 0] / LENGTH == pytest.approx([0, 0.25])
    assert mark[:, 0] / LENGTH == pytest.approx([0.8, 0.8])
    labels = column(chunks(recording, "/candidate/parts/text"), "Points2D:labels")[-1]
    assert labels == [
        *("residual", "0.25 / 0.80  -3.5", "model", "0.90 / 0.90  +0.0"),
        *("score", "0.70, needs 0.5"),
    ]


def test_what_leans_is_drawn_leaning(tmp_path: Path) -> None:
    turn = Rotation.from_euler("zy", [40, 20], degrees=True)
    T = np.eye(4)
    T[:3, :3] = turn.as_matrix() * (1.1, 0.9, 1.0)
    leaning = replace(make_detection(0, "saloon", "accepted"), T_world_object=T)
    path = draw(tmp_path / "run.rrd", make_run().with_messages(DETECTIONS, [leaning]))
    for entity, turns, centres in (
        ("/verify/accepted", "Boxes3D:quaternions", "Boxes3D:centers"),
        ("/threshold/detections", "Boxes3D:quaternions", "Boxes3D:centers"),
    ):
        found = chunks(path, entity, static=False)
        assert Rotation.from_quat(column(found, turns)[-1][0]).approx_equal(turn, atol=1e-5)
        expected = leaning.position_world + turn.apply([0, 0, 0.75])
        np.testing.assert_allclose(column(found, centres)[-1][0], expected, atol=1e-6)
    frame = column(chunks(path, "/frames/candidate"), "Transform3D:quaternion")[-1]
    assert Rotation.from_quat(frame[0]).approx_equal(turn, atol=1e-5)


def test_a_candidate_is_shown_in_the_photo_that_has_it_largest(tmp_path: Path) -> None:
    """A camera 12 m above the first candidate, its photo green where the box's base lies."""
    width, height, focal = 600, 400, 500.0
    pixels = np.full((height, width, 3), 250, np.uint8)
    pixels[200 - 41 : 200 + 41, 300 - 82 : 300 + 82] = (0, 200, 0)
    Image.fromarray(pixels).save(tmp_path / "near.png")
    Image.fromarray(pixels).save(tmp_path / "far.png")
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    down = (1.0, 0.0, 0.0, 0.0)  # looks along -z, its right is +x
    names = ("near.png", "far.png", "gone.png")
    heights = np.array([[0, 0, 12.0], [0, 0, 30.0], [0, 0, 11.0]])
    run = make_run()
    run = run.with_messages(CAMERAS, [Cameras(heights, np.array([down] * 3), names)])
    lenses = [Calibration(name, width, height, K, "plumb_bob", (0.0,) * 5) for name in names]
    run = run.with_messages(CALIBRATIONS, lenses)
    run = run.with_messages(SCENE, [replace(run(SCENE)[0], photos=str(tmp_path))])
    run = run.with_messages(UPRIGHT, [Upright((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0))])
    low = replace(make_detection(0, "saloon", "accepted"), heading_deg=0.0, size_m=(4.0, 2.0, 0.01))
    aside = replace(make_detection(1, "saloon", "rejected"), position_world=(90.0, 0.0, 0.0))
    path = draw(tmp_path / "run.rrd", run.with_messages(DETECTIONS, [low, aside]))
    (blob,) = column(chunks(path, "/candidate/photo/image", static=False), "EncodedImage:blob")
    cut = np.asarray(Image.open(io.BytesIO(bytes(blob[0]))).convert("RGB")).astype(int)
    (strips,) = column(chunks(path, "/candidate/photo/box", static=False), "LineStrips2D:strips")
    corners = np.array(strips).reshape(-1, 2)
    u, v = np.mgrid[: cut.shape[1], : cut.shape[0]]
    inside = (u > corners[:, 0].min()) & (u < corners[:, 0].max())
    inside &= (v > corners[:, 1].min()) & (v < corners[:, 1].max())
    green = (cut[..., 0] < 128).T
    assert (inside == green).mean() > 0.98
    cleared = chunks(path, "/candidate/photo", static=False)
    assert column(cleared, "candidate") == [1000]
    planes = chunks(path, "/ingest/cameras/**")
    assert len(column(planes, "Pinhole:image_from_camera")) == 3
    assert len(column(planes, "EncodedImage:blob")) == 2


def test_a_wide_lens_bends_as_opencv_says() -> None:
    """[docs.opencv.org, camera calibration]: x (1 + k1 r^2 + ...) + 2 p1 x y + p2 (r^2 + 2 x^2)."""
    lens = Calibration("a", 100, 100, np.eye(3), "plumb_bob", (0.1, 0.01, 0.02, 0.03, 0.001))
    photo = Photo("a", None, np.zeros(3), np.eye(3), lens)
    ((u, v, depth),) = photo.project(np.array([[1.0, 2.0, 2.0]]))
    x, y, r2 = 0.5, 1.0, 1.25
    radial = 1 + 0.1 * r2 + 0.01 * r2**2 + 0.001 * r2**3
    assert u == pytest.approx(x * radial + 2 * 0.02 * x * y + 0.03 * (r2 + 2 * x * x))
    assert v == pytest.approx(y * radial + 0.02 * (r2 + 2 * y * y) + 2 * 0.03 * x * y)
    assert depth == 2.0


def test_own_spin_image_stands_beside_the_model_s(recording: Path) -> None:
    for name in ("own", "model", "difference"):
        found = chunks(recording, f"/candidate/spin/{name}", static=False)
        steps = [s for s in column(found, "candidate") if s is not None]
        assert 0 in steps
    own = column(chunks(recording, "/candidate/spin/own"), "DepthImage:format")
    assert own[0][0]["width"] == 5


def test_the_threshold_brings_what_reaches_it(recording: Path) -> None:
    hits = chunks(recording, "/threshold/hits", static=False)
    assert column(hits, "threshold") == [10]  # a correlation of 0.9
    assert len(column(hits, "Points3D:positions")[0]) == 30
    boxes = chunks(recording, "/threshold/detections", static=False)
    assert column(boxes, "threshold") == [30, 40, 50]  # scores of 0.7, 0.6, 0.5
    assert column(chunks(recording, "/threshold/candidates", static=False), "threshold") == [20]


def test_labels_colour_the_threshold(tmp_path: Path) -> None:
    rec = open_recording("test", "save", tmp_path / "run.rrd")
    assert rec is not None
    truth = Truth({0: True, 1: False}, np.array([[1.0, 2.0, 0.0]]))
    for stage in STAGES:
        record_stage(stage, make_run(), rec, 1000, truth)
    close_recording(rec, tmp_path / "run.rrd")
    boxes = chunks(tmp_path / "run.rrd", "/threshold/detections", static=False)
    colours = [row[0] >> 8 for row in column(boxes, "Boxes3D:colors")]  # rejected, false, found
    assert colours[1:] == [
        int.from_bytes(bytes(c)) for c in (palette.UNEXPLAINED, palette.ACCEPTED)
    ]
    missed = chunks(tmp_path / "run.rrd", "/threshold/missed", static=True)
    assert column(missed, "Points3D:positions") == [[[1.0, 2.0, 0.0]]]


def test_labels_of_kept_ones_do_not_hide_each_other(tmp_path: Path) -> None:
    near = [
        replace(
            make_detection(0, "saloon", "accepted"),
            id=i,
            cluster=i,
            position_world=(0.01 * i, 0, 0),
        )
        for i in range(20)
    ]
    path = draw(tmp_path / "run.rrd", make_run().with_messages(DETECTIONS, near))
    (labels,) = column(chunks(path, "/verify/labels", static=False), "Points3D:labels")
    assert labels == ["0"]


def test_the_cloud_has_a_second_colouring_by_height(recording: Path) -> None:
    cloud = chunks(recording, "/ingest/cloud/**")
    assert sum(len(row) for row in column(cloud, "Height:colors")) == 1000


def test_best_curve_follows_the_lowest_start_and_breaks_off(recording: Path) -> None:
    best = np.array(column(chunks(recording, "/verify/rms/best", static=False), "Scalars:scalars"))
    expected = np.nanmin(make_run()(TRACES)[0].rms_m, axis=0)
    np.testing.assert_allclose(best[1 : ITERATIONS + 1, 0], expected)
    assert np.isnan(best[ITERATIONS + 1, 0])


def test_ledger_holds_every_candidate_with_its_reason(recording: Path) -> None:
    ledger = chunks(recording, "/verify/ledger")
    assert column(ledger, "candidate") == [0, 1000, 2000]
    assert column(ledger, "fate") == [[fate] for fate in FATES]
    assert column(ledger, "reason") == [[f"{fate} for a reason"] for fate in FATES]


def test_notes_follow_the_cursor(recording: Path) -> None:
    notes = chunks(recording, "/notes")
    texts = [row[0] for row in column(notes, "TextDocument:text")]
    assert len(texts) == len(STAGES) + 3
    assert "yard.ply" in texts[0]
    assert "1 accepted, 1 ambiguous, 1 rejected" in texts[STAGE_NUMBER["verify"] - 1]
    assert "rejected for a reason" in texts[-1]


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
