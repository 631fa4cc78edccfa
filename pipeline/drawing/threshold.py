"""Draw the timeline ``threshold``: what appears as less and less is asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.boxes import boxes_of
from spinpipe.pipeline.drawing.drawing import WORLD, Reader, place
from spinpipe.pipeline.drawing.preview import preview_rows
from spinpipe.pipeline.drawing.timelines import THRESHOLD_STEPS, threshold_steps
from spinpipe.schemas import CLUSTERS, HITS
from spinpipe.schemas.arrays import F32, F64, I64, U8
from spinpipe.schemas.records import Detection

ROOT = "threshold"
FOUND, FALSE, MISSED = palette.ACCEPTED, palette.UNEXPLAINED, palette.HIT


@dataclass(frozen=True)
class Truth:
    """What labels say about a run."""

    found: Mapping[int, bool] = field(default_factory=dict[int, bool])
    """By the id of a detection: whether it stands on a labelled object."""
    missed: F64 = field(default_factory=lambda: np.empty((0, 3)))
    """(N, 3) labelled objects that no accepted detection stands on, world."""


def draw_threshold(
    read: Reader,
    rec: rr.RecordingStream,
    detections: Sequence[Detection],
    preview_points: int,
    truth: Truth | None = None,
) -> None:
    """Log hits, candidates and detections at the step from which on they count.

    A view of them shows all steps up to the cursor. Detections are coloured by fate; with labels
    green where one stands on an object, orange where not, and missed objects are marked.
    """
    for name in ("hits", "candidates", "detections", "missed"):
        place(rec, f"{ROOT}/{name}", WORLD)
    points, values = [np.empty((0, 3), np.float32)], [np.empty(0, np.float32)]
    for group in read(HITS):
        (rows,) = preview_rows([len(group.points)], preview_points)
        points.append(group.points[rows])
        values.append(group.correlation[rows])
    _hits(rec, np.concatenate(points), np.concatenate(values))
    clusters = read(CLUSTERS)
    at = threshold_steps([c.correlation for c in clusters])
    _marks(rec, "candidates", at, np.array([c.position for c in clusters]).reshape(-1, 3))
    _detections(rec, detections, truth)
    if truth is not None and len(truth.missed):
        rings = rr.Points3D(truth.missed, colors=MISSED, radii=-9.0)
        rec.log(f"{ROOT}/missed", rings, static=True)
    _curves(rec, at, detections)


def _hits(rec: rr.RecordingStream, xyz: F32, correlation: F32) -> None:
    steps = threshold_steps(correlation)
    order = np.argsort(steps, kind="stable")
    which, counts = np.unique(steps[order], return_counts=True)
    if not len(which):
        return
    columns = rr.Points3D.columns(positions=xyz[order])
    index = [rr.TimeColumn("threshold", sequence=which)]
    rec.send_columns(f"{ROOT}/hits", indexes=index, columns=columns.partition(counts))


def _marks(rec: rr.RecordingStream, name: str, at: I64, xyz: F64) -> None:
    order = np.argsort(at, kind="stable")
    which, counts = np.unique(at, return_counts=True)
    if len(which):
        columns = rr.Points3D.columns(positions=xyz[order])
        index = [rr.TimeColumn("threshold", sequence=which)]
        rec.send_columns(f"{ROOT}/{name}", indexes=index, columns=columns.partition(counts))


def _detections(
    rec: rr.RecordingStream, detections: Sequence[Detection], truth: Truth | None
) -> None:
    shown = sorted((d for d in detections if d.fate != "duplicate"), key=lambda d: -d.score)
    if not shown:
        return
    boxes = boxes_of(shown)
    which, counts = np.unique(threshold_steps([d.score for d in shown]), return_counts=True)
    columns = rr.Boxes3D.columns(
        centers=boxes.centers,
        half_sizes=boxes.sizes / 2,
        quaternions=boxes.quaternions,
        colors=np.array([_colour(d, truth) for d in shown], np.uint8),
    )
    index = [rr.TimeColumn("threshold", sequence=which)]
    rec.send_columns(f"{ROOT}/detections", indexes=index, columns=columns.partition(counts))


def _colour(d: Detection, truth: Truth | None) -> tuple[int, ...]:
    if truth is None or d.id not in truth.found:
        return palette.fate_colour(d.fate)[:3]
    return FOUND if truth.found[d.id] else FALSE


def _curves(rec: rr.RecordingStream, candidates: I64, found: Sequence[Detection]) -> None:
    """How many candidates and detections there are at each step."""
    steps = np.arange(THRESHOLD_STEPS + 1)
    scores = threshold_steps([d.score for d in found if d.fate != "duplicate"])
    kept = threshold_steps([d.score for d in found if d.fate == "accepted"])
    rows = [
        np.searchsorted(np.sort(values), steps, side="right")
        for values in (candidates, scores, kept)
    ]
    names = ["candidates", "fits of this score", "accepted"]
    colours: U8 = np.array([palette.PALE, palette.REJECTED, palette.ACCEPTED], np.uint8)
    rec.log(f"{ROOT}/counts", rr.SeriesLines(names=names, colors=colours), static=True)
    rec.send_columns(
        f"{ROOT}/counts",
        indexes=[rr.TimeColumn("threshold", sequence=steps)],
        columns=rr.Scalars.columns(
            scalars=np.log10(1 + np.stack(rows, axis=1)).reshape(-1)
        ).partition(np.full(len(steps), len(rows))),
    )
