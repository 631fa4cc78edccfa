"""Draw what is around each candidate, on the timeline ``candidate``: why it won or lost, seen.

All in the candidate's own frame, so that every fit looks alike when it is right. As columns, one
call an entity: a scene has hundreds of candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.closeup import Closeup, closeups
from spinpipe.pipeline.drawing.drawing import CANDIDATE, STAGE_NUMBER, Reader, place
from spinpipe.pipeline.drawing.model import model_bounds
from spinpipe.pipeline.drawing.parts import draw_parts
from spinpipe.pipeline.drawing.timelines import candidate_step
from spinpipe.schemas import MODELS, SPIN_IMAGES
from spinpipe.schemas.arrays import F32, F64, U8
from spinpipe.schemas.records import Detection
from spinpipe.stages.geometry.frames import heading_quaternion

ROOT = "candidate"
FEWEST_POINTS, MOST_POINTS = 300, 2500
"""Of the cloud around one candidate."""
WHAT_COLOURS = np.array(
    [palette.GROUND_POINT, palette.EXPLAINED, palette.UNEXPLAINED, palette.PALE], np.uint8
)
SIGHT_COLOURS = np.array([palette.SEEN, palette.CONTRADICTED, palette.NOT_OBSERVED], np.uint8)


def draw_candidates(
    read: Reader, rec: rr.RecordingStream, ranked: Sequence[Detection], preview_points: int
) -> None:
    """Log points, surface, outlines and spin images of candidates, the best one first."""
    if not ranked:
        return
    points = int(np.clip(preview_points // len(ranked), FEWEST_POINTS, MOST_POINTS))
    looks = list(closeups(read, ranked, points))
    looks.sort(key=lambda look: look.detection.id)
    for path in ("points", "surface", "box", "runner_up", "next_model"):
        place(rec, f"{ROOT}/{path}", CANDIDATE)
    steps = [candidate_step(look.detection.id) for look in looks]
    sizes = {m.name: np.ptp(model_bounds(m), axis=0) for m in read(MODELS)}
    spins = {i.model: i.values for i in read(SPIN_IMAGES) if i.role == "model"}
    best = next(look for look in looks if look.detection.id == ranked[0].id)
    for timeline, at, shown in (
        ("stage", [STAGE_NUMBER["verify"]], [best]),
        ("candidate", steps, looks),
    ):
        index = [rr.TimeColumn(timeline, sequence=at)]
        what = [WHAT_COLOURS[c.what] for c in shown]
        _points(rec, "points", index, [c.xyz for c in shown], what)
        sight = [SIGHT_COLOURS[c.sight] for c in shown]
        _points(rec, "surface", index, [c.surface for c in shown], sight)
        _boxes(rec, "box", index, [_own_box(c.detection) for c in shown])
        _boxes(rec, "runner_up", index, [_runner_up(c.detection) for c in shown])
        _boxes(rec, "next_model", index, [_next_model(c.detection, sizes) for c in shown])
        draw_parts(rec, index, [c.detection for c in shown])
        for step, look in zip(at, shown, strict=True):
            rec.reset_time()
            rec.set_time(timeline, sequence=step)
            _spin_images(rec, look, spins.get(look.detection.model))


def _points(
    rec: rr.RecordingStream,
    name: str,
    index: list[rr.TimeColumn],
    xyz: Sequence[F32],
    colours: Sequence[U8],
) -> None:
    lengths = [len(points) for points in xyz]
    columns = rr.Points3D.columns(positions=np.concatenate(xyz), colors=np.concatenate(colours))
    rec.send_columns(f"{ROOT}/{name}", indexes=index, columns=columns.partition(lengths))


_Box = tuple[F64, float, str, palette.Colour]
"""Size (3,), turn about z in degrees, label and colour; a size of zero hides it."""


def _boxes(
    rec: rr.RecordingStream, name: str, index: list[rr.TimeColumn], boxes: Sequence[_Box]
) -> None:
    size = np.array([box[0] for box in boxes], np.float64)
    hidden = ~size.any(axis=1)
    columns = rr.Boxes3D.columns(
        centers=size * (0, 0, 0.5),
        half_sizes=size / 2,
        quaternions=heading_quaternion([box[1] for box in boxes]),
        colors=np.array([box[3][:3] for box in boxes], np.uint8),
        radii=np.where(hidden, 0.0, -1.2 if name == "box" else -0.8),
        fill_mode=[rr.components.FillMode.MajorWireframe] * len(boxes),
        labels=[box[2] for box in boxes],
        # what it is itself stands in the notes
        show_labels=[name != "box" and bool(size.any()) for size, *_ in boxes],
    )
    rec.send_columns(f"{ROOT}/{name}", indexes=index, columns=columns)


def _own_box(d: Detection) -> _Box:
    colour = palette.fate_colour(d.fate)
    return np.asarray(d.size_m), 0.0, f"{d.id} {d.model} {d.score:.2f}", colour


def _runner_up(d: Detection) -> _Box:
    """Where the second best heading has it."""
    exists = np.isfinite(d.runner_up_rms_m)
    size = np.asarray(d.size_m) * (0.98 if exists else 0.0)
    turn = d.runner_up_heading_deg - d.heading_deg if exists else 0.0
    return size, turn, f"runner-up {d.runner_up_heading_deg:.0f}°" if exists else "", palette.MARK


def _next_model(d: Detection, sizes: dict[str, F64]) -> _Box:
    """The next best model as it is, unstretched, at the same place."""
    size = sizes.get(d.alternative)
    if size is None:
        return np.zeros(3), 0.0, "", palette.PALE
    return size, 0.0, f"{d.alternative} {d.score - d.alternative_margin:.2f}", palette.HIT


def _spin_images(rec: rr.RecordingStream, look: Closeup, model: F32 | None) -> None:
    """Its own image, the model's and their difference, each as shares of all points."""
    if model is None or model.shape != look.spin.shape:
        rec.log(f"{ROOT}/spin", rr.Clear(recursive=True))
        return
    own, right = (image / max(float(image.sum()), 1.0) for image in (look.spin, model))
    most = max(float(own.max()), float(right.max()), 1e-9)
    for name, image in (("own", own), ("model", right)):
        shape = rr.DepthImage(
            image.astype(np.float32),
            colormap="viridis",
            depth_range=(0.0, most),
            magnification_filter="nearest",
        )
        rec.log(f"{ROOT}/spin/{name}", shape)
    shape = rr.Image(signed_colours((own - right) / most), magnification_filter="nearest")
    rec.log(f"{ROOT}/spin/difference", shape)


def signed_colours(values: NDArray[Any]) -> U8:
    """(H, W, 3): white at 0, orange towards 1, blue towards -1."""
    v = np.clip(np.asarray(values, np.float64), -1, 1)[..., None]
    more, less = np.array(palette.UNEXPLAINED), np.array(palette.SERIES[0])
    return np.where(v > 0, 255 + (more - 255) * v, 255 + (less - 255) * -v).astype(np.uint8)
