"""Draw what became of the candidates: boxes, headings, the reasons, and each registration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.boxes import boxes_of
from spinpipe.pipeline.drawing.candidates import ROOT as CLOSE
from spinpipe.pipeline.drawing.candidates import draw_candidates
from spinpipe.pipeline.drawing.closeup import worth_a_look
from spinpipe.pipeline.drawing.drawing import NOTES, WORLD, Reader, at_stage, clear_stale, note, put
from spinpipe.pipeline.drawing.eye import label_rows
from spinpipe.pipeline.drawing.fits import (
    draw_fits,
    draw_pose,
    draw_shapes,
    first_steps,
    order_fits,
)
from spinpipe.pipeline.drawing.photos import draw_candidate_photos
from spinpipe.pipeline.drawing.texts import candidate_text, outcome_text
from spinpipe.pipeline.drawing.threshold import Truth, draw_threshold
from spinpipe.schemas import DETECTIONS, MODELS, TRACES
from spinpipe.schemas.records import Detection

CLOSE_UP = 250
"""Candidates that are looked at closely."""
BOXED, DOT_RADIUS = 150, -2.0
"""Most boxes of one fate that lost; radius of a dot instead, on the screen."""
_LEDGER = (
    *("fate", "score", "model", "reason", "correlation", "rms_m", "coverage_model"),
    *("coverage_scene", "heading_margin", "cause", "duplicate_of", "log_odds"),
)
"""Columns of the table of all candidates: fields of a detection."""


def draw(
    read: Reader, rec: rr.RecordingStream, preview_points: int, truth: Truth | None = None
) -> None:
    """Log all fates at once, then candidate by candidate, then by threshold."""
    detections = sorted(read(DETECTIONS), key=lambda d: (d.id, d.score))
    models = {model.name: model for model in read(MODELS)}
    draw_shapes(rec, list(models.values()))
    at_stage(rec, "verify")
    for fate in palette.FATES:
        group = [d for d in detections if d.fate == fate][:preview_points]
        if fate in palette.KEPT or len(group) <= BOXED:
            _draw_boxes(rec, fate, group)
        else:
            _draw_dots(rec, fate, group)
    _draw_labels(read, rec, detections)
    note(rec, outcome_text(detections))
    if not detections:
        return
    draw_pose(rec, max(detections, key=lambda d: (d.fate == "accepted", d.score)), models)
    _draw_ledger(rec, detections)
    ranked = worth_a_look(detections, CLOSE_UP)
    close = {d.id for d in ranked}
    fits = order_fits(detections, [trace for trace in read(TRACES) if trace.cluster in close])
    draw_fits(rec, fits, models)
    clear_stale(rec, CLOSE, detections, close)
    draw_candidates(read, rec, ranked, fits, preview_points)
    draw_candidate_photos(read, rec, ranked)
    rec.send_columns(
        NOTES,
        indexes=first_steps(fits),
        columns=rr.TextDocument.columns(
            text=[candidate_text(fit.detection) for fit in fits],
            media_type=[rr.MediaType.MARKDOWN] * len(fits),
        ),
    )
    draw_threshold(read, rec, detections, preview_points, truth)


def _draw_boxes(rec: rr.RecordingStream, fate: str, detections: Sequence[Detection]) -> None:
    kept = fate in palette.KEPT
    boxes = boxes_of(detections)
    put(
        rec,
        f"verify/{fate}",
        rr.Boxes3D(
            centers=boxes.centers,
            # a rejected box often has an accepted one at its very place: stay inside of that
            half_sizes=boxes.sizes / 2 * (1.0 if kept else 0.97),
            quaternions=boxes.quaternions,
            colors=palette.FATES[fate],
            radii=-1.2 if kept else -0.5,
            fill_mode="MajorWireframe",
            labels=_texts(detections),
            show_labels=False,
        ),
        WORLD,
    )
    if not kept:
        return
    put(
        rec,
        f"verify/{fate}/heading",
        rr.Arrows3D(
            origins=boxes.tops,
            vectors=boxes.forward * boxes.sizes[:, :1] * 0.7,
            colors=palette.FATES[fate],
            radii=-1.2,
        ),
        WORLD,
    )


def _draw_dots(rec: rr.RecordingStream, fate: str, detections: Sequence[Detection]) -> None:
    """A dot each: boxes of thousands would hide the scene."""
    dots = rr.Points3D(
        boxes_of(detections).tops,
        colors=palette.FATES[fate],
        radii=DOT_RADIUS,
        labels=_texts(detections),
        show_labels=False,
    )
    put(rec, f"verify/{fate}", dots, WORLD)


def _texts(detections: Sequence[Detection]) -> list[str]:
    return [f"{d.id} {d.model} {d.score:.2f}: {d.reason}" for d in detections]


def _draw_labels(read: Reader, rec: rr.RecordingStream, detections: Sequence[Detection]) -> None:
    """Ids above the kept ones, as many as fit side by side as the scene is first seen."""
    kept = sorted((d for d in detections if d.fate in palette.KEPT), key=lambda d: -d.score)
    kept.sort(key=lambda d: palette.rank(d.fate))
    tops = boxes_of(kept).tops
    rows = label_rows(read, tops)
    shape = rr.Points3D(
        tops[rows],
        colors=np.array([palette.fate_colour(kept[i].fate)[:3] for i in rows]).reshape(-1, 3),
        radii=-0.1,
        labels=[str(kept[i].id) for i in rows],
        show_labels=True,
    )
    put(rec, "verify/labels", shape, WORLD)


def _draw_ledger(rec: rr.RecordingStream, detections: Sequence[Detection]) -> None:
    """One row a candidate, with the numbers that decided."""
    columns: dict[str, list[str | float]] = {
        name: [_rounded(getattr(d, name)) for d in detections] for name in _LEDGER
    }
    columns["heading_world_deg"] = [_rounded(d.heading_deg) for d in detections]
    for i, axis in enumerate("xyz"):
        columns[f"{axis}_scene"] = [_rounded(d.position_scene[i]) for d in detections]
    rec.send_columns(
        "verify/ledger",
        indexes=first_steps(order_fits(detections, [])),
        columns=rr.AnyValues.columns(True, **columns),
    )


def _rounded(value: str | float) -> str | float:
    return round(value, 3) if isinstance(value, float) else value
