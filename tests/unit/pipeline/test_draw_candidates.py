"""What a recording shows of each candidate: photos, the threshold, ledger and notes."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from tests.unit.pipeline.drawn import (
    FATES,
    ITERATIONS,
    STAGES,
    STARTS,
    chunks,
    column,
    draw,
    make_detection,
    make_run,
)

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.courses import HEIGHT, WIDTH
from spinpipe.pipeline.drawing.drawing import STAGE_NUMBER
from spinpipe.pipeline.drawing.parts import LENGTH
from spinpipe.pipeline.drawing.photos import Photo
from spinpipe.pipeline.drawing.recording import (
    close_recording,
    open_recording,
    record_stage,
)
from spinpipe.pipeline.drawing.texts import candidate_text
from spinpipe.pipeline.drawing.threshold import Truth
from spinpipe.pipeline.drawing.verify import BOXED
from spinpipe.schemas import (
    CALIBRATIONS,
    CAMERAS,
    DETECTIONS,
    SCENE,
    SPIN_IMAGES,
    TRACES,
    UPRIGHT,
)
from spinpipe.schemas.poses import Calibration, Cameras
from spinpipe.schemas.records import Upright

pytestmark = pytest.mark.usefixtures("strict")


def test_a_candidate_is_joined_with_the_steps_of_its_registration(recording: Path) -> None:
    saloon = chunks(recording, "/verify/fit/saloon", static=False)
    moves = [c for c in saloon if c.timeline_names == ["candidate"]]
    steps = sorted(set(column(moves, "candidate")))
    # candidates 0 and 2 were traced, 1 shows its reported pose only, as another model
    walked = range(ITERATIONS + 2)
    assert steps == [*walked, 1000, *(2000 + i for i in walked)]
    cursor = chunks(recording, "/candidate/registration/now", static=False)
    assert column(cursor, "candidate") == steps
    places = [row[0][0][0] for row in column(cursor, "LineStrips2D:strips")]
    walk = np.linspace(0, WIDTH, ITERATIONS)
    expected = [WIDTH, *walk, WIDTH]  # as reported, on its way, as reported
    assert places == pytest.approx([*expected, 0, *expected])


def test_every_candidate_has_its_surroundings_explained(recording: Path) -> None:
    steps = [0, 1000, 2000]
    own = ("points", "surface", "box", "runner_up", "next_model", "names")
    for path in (*own, "parts/bars", "spin/images", "registration/residuals"):
        found = chunks(recording, f"/candidate/{path}", static=False)
        assert [s for s in column(found, "candidate") if s is not None] == steps
        # of the best: no pane is empty on the other timelines
        assert column(found, "stage") == [STAGE_NUMBER["verify"]]
        assert column(found, "threshold") == [0]
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
    found = chunks(recording, "/candidate/spin/images", static=False)
    (model,) = (
        i.values for i in make_run()(SPIN_IMAGES) if (i.role, i.model) == ("model", "saloon")
    )
    height, width = model.shape
    form, data = (column(found, f"Image:{name}")[0][0] for name in ("format", "buffer"))
    assert (form["width"], form["height"]) == (3 * width + 2, height)
    own, _, right, _, difference = np.split(
        np.array(data, np.uint8).reshape(height, -1, 3),
        [width, width + 1, 2 * width + 1, 2 * width + 2],
        axis=1,
    )
    same = (own == right).all(axis=2)
    assert (difference[same] == 255).all()
    names = column(chunks(recording, "/candidate/spin/names", static=False), "Points2D:labels")
    assert names[0] == ["its own", "model's", "difference"]


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
            position_world=(0.01 * i, 0, 0),
        )
        for i in range(20)
    ]
    path = draw(tmp_path / "run.rrd", make_run().with_messages(DETECTIONS, near))
    (labels,) = column(chunks(path, "/verify/labels", static=False), "Points3D:labels")
    assert labels == ["0"]


def test_the_chart_shows_every_start_and_the_lowest_of_them(recording: Path) -> None:
    found = chunks(recording, "/candidate/registration/residuals", static=False)
    rows = column(found, "LineStrips2D:strips")
    rms = make_run()(TRACES)[0].rms_m
    low, high = np.nanmin(rms), np.nanmax(rms)
    *starts, best = (np.array(strip) for strip in rows[0])
    assert [len(start) for start in starts] == np.isfinite(rms).sum(axis=1).tolist()
    np.testing.assert_allclose(
        high - best[:, 1] * (high - low) / HEIGHT, np.nanmin(rms, axis=0), rtol=1e-5
    )
    assert [len(row) for row in rows] == [STARTS + 1] * 2 + [0, STARTS + 1]  # 1 was not traced
    numbers = column(chunks(recording, "/candidate/registration/numbers"), "Points2D:labels")
    assert numbers[0] == [f"{high:.3f} m", f"{low:.3f} m", f"{ITERATIONS} steps"]


def test_thousands_that_lost_do_not_hide_the_scene(tmp_path: Path) -> None:
    lost = [replace(make_detection(0, "saloon", "rejected"), id=i) for i in range(BOXED + 1)]
    path = draw(tmp_path / "run.rrd", make_run().with_messages(DETECTIONS, lost))
    found = chunks(path, "/verify/rejected", static=False)
    assert "Boxes3D:half_sizes" not in found[0].to_record_batch().schema.names
    (labels,) = column(found, "Points3D:labels")
    assert labels[0].startswith("0 saloon 0.50: rejected for a reason")


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


def test_no_number_beside_a_candidate_is_cut() -> None:
    """The pane of the notes is as wide as 24 characters behind the names."""
    for detection in make_run()(DETECTIONS):
        rows = [line for line in candidate_text(detection).splitlines() if line.startswith("| ")]
        assert len(rows) > 6
        assert all(len(row.split(" | ")[1].rstrip(" |")) <= 24 for row in rows[1:])
