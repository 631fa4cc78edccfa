"""Draw what is around each candidate, on the timeline ``candidate``: why it won or lost, seen.

All in the candidate's own frame, so that every fit looks alike when it is right. As columns, one
call an entity: a scene has hundreds of candidates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.closeup import Closeup, closeups
from spinpipe.pipeline.drawing.courses import draw_courses, draw_cursor
from spinpipe.pipeline.drawing.drawing import CANDIDATE, STAGE_NUMBER, Reader, place
from spinpipe.pipeline.drawing.fits import Fit
from spinpipe.pipeline.drawing.model import model_bounds
from spinpipe.pipeline.drawing.parts import draw_parts
from spinpipe.pipeline.drawing.timelines import candidate_step
from spinpipe.schemas import MODELS, SPIN_IMAGES
from spinpipe.schemas.arrays import F32, F64, U8
from spinpipe.schemas.colormap import viridis
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
    read: Reader,
    rec: rr.RecordingStream,
    ranked: Sequence[Detection],
    fits: Sequence[Fit],
    preview_points: int,
) -> None:
    """Log points, surface, outlines, parts, registration and spin images of candidates.

    The first of them is also what is shown on the other timelines once the run has ended.
    """
    if not ranked:
        return
    points = int(np.clip(preview_points // len(ranked), FEWEST_POINTS, MOST_POINTS))
    looks = list(closeups(read, ranked, points))
    looks.sort(key=lambda look: look.detection.id)
    for path in ("points", "surface", "box", "runner_up", "next_model", "names"):
        place(rec, f"{ROOT}/{path}", CANDIDATE)
    steps = [candidate_step(look.detection.id) for look in looks]
    sizes = {m.name: np.ptp(model_bounds(m), axis=0) for m in read(MODELS)}
    spins = {i.model: i.values for i in read(SPIN_IMAGES) if i.role == "model"}
    best = next(look for look in looks if look.detection.id == ranked[0].id)
    fit_of = {fit.detection.id: fit for fit in fits}
    first = [
        rr.TimeColumn("stage", sequence=[STAGE_NUMBER["verify"]]),
        rr.TimeColumn("threshold", sequence=[0]),
    ]
    for index, shown in (
        (first, [best]),
        ([rr.TimeColumn("candidate", sequence=steps)], looks),
    ):
        what = [WHAT_COLOURS[c.what] for c in shown]
        _points(rec, "points", index, [c.xyz for c in shown], what)
        sight = [SIGHT_COLOURS[c.sight] for c in shown]
        _points(rec, "surface", index, [c.surface for c in shown], sight)
        _boxes(rec, "box", index, [_own_box(c.detection) for c in shown])
        _boxes(rec, "runner_up", index, [_runner_up(c.detection) for c in shown])
        _boxes(rec, "next_model", index, [_next_model(c.detection, sizes) for c in shown])
        _names(rec, index, [c.detection for c in shown])
        draw_parts(rec, index, [c.detection for c in shown])
        draw_courses(rec, index, [fit_of[c.detection.id] for c in shown])
        _spin_images(rec, index, shown, spins)
    draw_cursor(rec, [fit_of[c.detection.id] for c in looks])


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


_Box = tuple[F64, float, palette.Colour]
"""Size (3,), turn about z in degrees and colour; a size of zero hides it."""


def _boxes(
    rec: rr.RecordingStream, name: str, index: list[rr.TimeColumn], boxes: Sequence[_Box]
) -> None:
    size = np.array([box[0] for box in boxes], np.float64)
    hidden = ~size.any(axis=1)
    columns = rr.Boxes3D.columns(
        centers=size * (0, 0, 0.5),
        half_sizes=size / 2,
        quaternions=heading_quaternion([box[1] for box in boxes]),
        colors=np.array([box[2][:3] for box in boxes], np.uint8),
        radii=np.where(hidden, 0.0, -1.2 if name == "box" else -0.8),
        fill_mode=[rr.components.FillMode.MajorWireframe] * len(boxes),
    )
    rec.send_columns(f"{ROOT}/{name}", indexes=index, columns=columns)


def _own_box(d: Detection) -> _Box:
    return np.asarray(d.size_m), 0.0, palette.fate_colour(d.fate)


def _runner_up(d: Detection) -> _Box:
    """Where the second best heading has it."""
    exists = np.isfinite(d.runner_up_rms_m)
    size = np.asarray(d.size_m) * (0.98 if exists else 0.0)
    turn = d.runner_up_heading_deg - d.heading_deg if exists else 0.0
    return size, turn, palette.MARK


def _next_model(d: Detection, sizes: dict[str, F64]) -> _Box:
    """The next best model as it is, unstretched, at the same place."""
    size = sizes.get(d.alternative)
    if size is None:
        return np.zeros(3), 0.0, palette.PALE
    return size, 0.0, palette.HIT


def _names(
    rec: rr.RecordingStream, index: list[rr.TimeColumn], detections: Sequence[Detection]
) -> None:
    """Name the outlines: the heading above the box, the model below it, one clear of the other."""
    every: list[list[tuple[float, str, palette.Colour]]] = []
    for d in detections:
        own: list[tuple[float, str, palette.Colour]] = []
        if np.isfinite(d.runner_up_rms_m):
            name = f"runner-up {d.runner_up_heading_deg:.0f}°"
            own.append((1.6 * d.size_m[2], name, palette.MARK))
        if d.alternative:
            name = f"{d.alternative} {d.score - d.alternative_margin:.2f}"
            own.append((-0.9 * d.size_m[2], name, palette.HIT))
        every.append(own)
    flat = [named for own in every for named in own]
    columns = rr.Points3D.columns(
        positions=np.array([(0, 0, z) for z, *_ in flat], np.float32).reshape(-1, 3),
        labels=[name for _, name, _ in flat],
        colors=np.array([colour[:3] for *_, colour in flat], np.uint8).reshape(-1, 3),
        radii=np.full(len(flat), -0.1),
    )
    counts = [len(own) for own in every]
    rec.send_columns(f"{ROOT}/names", indexes=index, columns=columns.partition(counts))


def _spin_images(
    rec: rr.RecordingStream,
    index: list[rr.TimeColumn],
    looks: Sequence[Closeup],
    models: Mapping[str, F32],
) -> None:
    """Log its own image, the model's and their difference side by side, a row a candidate."""
    pictures = [_side_by_side(look.spin, models.get(look.detection.model)) for look in looks]
    shapes = [
        rr.components.ImageFormat(
            width=p.shape[1], height=p.shape[0], color_model="RGB", channel_datatype="U8"
        )
        for p in pictures
    ]
    rec.send_columns(
        f"{ROOT}/spin/images",
        indexes=index,
        columns=rr.Image.columns(buffer=[p.tobytes() for p in pictures], format=shapes),
    )
    names = [name for p in pictures if p.size > 3 for name in ("its own", "model's", "difference")]
    middles = [
        (p.shape[1] * (2 * i + 1) / 6, p.shape[0]) for p in pictures if p.size > 3 for i in range(3)
    ]
    texts = rr.Points2D.columns(
        positions=np.array(middles, np.float32).reshape(-1, 2),
        labels=names,
        radii=np.zeros(len(names)),
        colors=np.tile(np.array(palette.WHITE, np.uint8), (len(names), 1)),
    )
    shown = [3 * (p.size > 3) for p in pictures]
    rec.send_columns(f"{ROOT}/spin/names", indexes=index, columns=texts.partition(shown))


def _side_by_side(spin: F32, model: F32 | None) -> U8:
    """Shares of all points (H, 3 W + 2, 3); one dark pixel where there is no image."""
    if model is None or model.shape != spin.shape:
        return np.full((1, 1, 3), palette.BACKGROUND, np.uint8)
    own, right = (image / max(float(image.sum()), 1.0) for image in (spin, model))
    most = max(float(own.max()), float(right.max()), 1e-9)
    gap = np.full((len(own), 1, 3), palette.BACKGROUND, np.uint8)
    pictures = (
        viridis(own, 0.0, most),
        gap,
        viridis(right, 0.0, most),
        gap,
        signed_colours((own - right) / most),
    )
    return np.hstack(pictures)


def signed_colours(values: NDArray[Any]) -> U8:
    """(H, W, 3): white at 0, orange towards 1, blue towards -1."""
    v = np.clip(np.asarray(values, np.float64), -1, 1)[..., None]
    more, less = np.array(palette.UNEXPLAINED), np.array(palette.SERIES[0])
    return np.where(v > 0, 255 + (more - 255) * v, 255 + (less - 255) * -v).astype(np.uint8)
