"""Draw what became of the candidates: boxes, headings, the reasons, and each registration."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.drawing import NOTES, WORLD, Reader, at_stage, note, put
from spinpipe.pipeline.drawing.fits import (
    Fit,
    draw_fits,
    draw_pose,
    draw_rms,
    draw_shapes,
    first_steps,
    order_fits,
)
from spinpipe.pipeline.drawing.model import model_bounds
from spinpipe.schemas import DETECTIONS, MODELS, TRACES
from spinpipe.schemas.records import F64, Detection, ObjectModel

_LEDGER = (
    "fate",
    "score",
    "correlation",
    "rms_m",
    "coverage_model",
    "coverage_scene",
    "heading_deg",
    "heading_margin",
    "model",
    "reason",
)
"""Columns of the table of all candidates: fields of a detection."""
_LABELLED = 12
_NOTED = 40


def draw_verify(read: Reader, rec: rr.RecordingStream, preview_points: int) -> None:
    """Log all fates at once, then candidate by candidate and iteration by iteration."""
    detections = sorted(read(DETECTIONS), key=lambda d: (d.cluster, d.score))
    models = {model.name: model for model in read(MODELS)}
    draw_shapes(rec, list(models.values()))
    at_stage(rec, "verify")
    for fate in palette.FATES:
        group = [d for d in detections if d.fate == fate][:preview_points]
        _draw_boxes(rec, fate, group, models)
    note(rec, _summary(detections))
    if not detections:
        return
    draw_pose(rec, max(detections, key=lambda d: (d.fate == "accepted", d.score)), models)
    _draw_ledger(rec, detections)
    _draw_numbers(rec, detections)
    fits = order_fits(detections, read(TRACES))
    draw_rms(rec, fits)
    _draw_fates(rec, fits)
    draw_fits(rec, fits, models)
    rec.send_columns(
        NOTES,
        indexes=first_steps(fits),
        columns=rr.TextDocument.columns(
            text=[_reasons(fit.detection) for fit in fits],
            media_type=[rr.MediaType.MARKDOWN] * len(fits),
        ),
    )


def _draw_boxes(
    rec: rr.RecordingStream,
    fate: str,
    detections: Sequence[Detection],
    models: Mapping[str, ObjectModel],
) -> None:
    rejected = fate == "rejected"
    sizes = np.array([_size(d, models) for d in detections]).reshape(-1, 3)
    base = np.array([d.position_world for d in detections]).reshape(-1, 3)
    heading = np.deg2rad([d.heading_deg for d in detections])
    zero = np.zeros_like(heading)
    put(
        rec,
        f"verify/{fate}",
        rr.Boxes3D(
            centers=base + sizes * (0, 0, 0.5),
            # a rejected box often has an accepted one at its very place: stay inside of that
            half_sizes=sizes / 2 * (0.97 if rejected else 1.0),
            quaternions=np.stack([zero, zero, np.sin(heading / 2), np.cos(heading / 2)], axis=-1),
            colors=palette.FATES[fate],
            radii=-0.5 if rejected else -1.2,
            fill_mode="MajorWireframe",
            labels=[f"{d.cluster} {d.model} {d.score:.2f}" for d in detections],
            show_labels=not rejected and len(detections) <= _LABELLED,
        ),
        WORLD,
    )
    if rejected:
        return
    forward = np.stack([np.cos(heading), np.sin(heading), zero], axis=-1)
    put(
        rec,
        f"verify/{fate}/heading",
        rr.Arrows3D(
            origins=base + sizes * (0, 0, 1),
            vectors=forward * sizes[:, :1] * 0.7,
            colors=palette.FATES[fate],
            radii=-1.2,
        ),
        WORLD,
    )


def _size(detection: Detection, models: Mapping[str, ObjectModel]) -> F64:
    size = np.array(detection.size_m, np.float64)
    model = models.get(detection.model)
    return np.diff(model_bounds(model), axis=0)[0] if model and not size.any() else size


def _draw_fates(rec: rr.RecordingStream, fits: Sequence[Fit]) -> None:
    rec.log(
        "verify/fate",
        rr.StateConfiguration(values=list(palette.FATES), colors=list(palette.FATES.values())),
        static=True,
    )
    rec.send_columns(
        "verify/fate",
        indexes=first_steps(fits),
        columns=rr.StateChange.columns(state=[fit.detection.fate for fit in fits]),
    )


def _draw_numbers(rec: rr.RecordingStream, detections: Sequence[Detection]) -> None:
    names = ("score", "correlation", "coverage_model", "coverage_scene")
    rec.log(
        "verify/numbers",
        rr.SeriesPoints(
            names=[name.replace("_", " of ") for name in names],
            colors=palette.series(len(names)),
            markers=["circle", "diamond", "up", "down"],
            marker_sizes=[5.0, 3.0, 3.0, 3.0],
        ),
        static=True,
    )
    rows = np.array([[getattr(d, name) for name in names] for d in detections])
    rec.send_columns(
        "verify/numbers",
        indexes=[rr.TimeColumn("candidate", sequence=[d.cluster for d in detections])],
        columns=rr.Scalars.columns(scalars=rows.reshape(-1)).partition(
            np.full(len(rows), len(names))
        ),
    )


def _draw_ledger(rec: rr.RecordingStream, detections: Sequence[Detection]) -> None:
    """One row a candidate, with the numbers that decided."""
    columns: dict[str, list[str | float]] = {
        name: [_rounded(getattr(d, name)) for d in detections] for name in _LEDGER
    }
    rec.send_columns(
        "verify/ledger",
        indexes=[rr.TimeColumn("candidate", sequence=[d.cluster for d in detections])],
        columns=rr.AnyValues.columns(True, **columns),
    )


def _rounded(value: str | float) -> str | float:
    return round(value, 3) if isinstance(value, float) else value


def _summary(detections: Sequence[Detection]) -> str:
    fates = Counter(d.fate for d in detections)
    kept = sorted((d for d in detections if d.fate != "rejected"), key=lambda d: (d.fate, -d.score))
    lines = [
        "## " + ", ".join(f"{fates[fate]} {fate}" for fate in palette.FATES),
        "",
        "| id | model | x m | y m | heading | score | fate |",
        "|---|---|---|---|---|---|---|",
    ]
    for d in kept[:_NOTED]:
        x, y, _ = d.position_world
        lines.append(
            f"| {d.cluster} | {d.model} | {x:.2f} | {y:.2f} | {d.heading_deg:.0f}° "
            f"| {d.score:.2f} | {d.fate} |"
        )
    if len(kept) > _NOTED:
        lines.append(f"\n... and {len(kept) - _NOTED} more")
    return "\n".join(lines)


def _reasons(d: Detection) -> str:
    rival = f"{d.runner_up_rms_m:.3f} m at {d.runner_up_heading_deg:.0f}°"
    numbers = [
        ("score", f"{d.score:.3f}"),
        ("correlation", f"{d.correlation:.3f}"),
        ("residual", f"{d.rms_m:.3f} m, {d.inliers} inliers"),
        ("runner-up", rival if math.isfinite(d.runner_up_rms_m) else "none"),
        ("heading", f"{d.heading_deg:.1f}°, margin {d.heading_margin:.2f}"),
        ("model explained by scene", f"{d.coverage_model:.0%}"),
        ("scene explained by model", f"{d.coverage_scene:.0%}"),
        ("surface that could be seen", f"{d.observed:.0%}"),
    ]
    if d.alternative:
        numbers.append(("next best model", f"{d.alternative}, margin {d.alternative_margin:.2f}"))
    numbers += [(part.name, f"{part.value:.4g}") for part in d.parts]
    lines = [f"## Candidate {d.cluster}: {d.model} {d.fate}", d.reason, "", "| | |", "|---|---|"]
    return "\n".join(lines + [f"| {name} | {value} |" for name, value in numbers])
