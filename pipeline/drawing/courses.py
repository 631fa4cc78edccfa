"""Draw the residuals of a registration over its steps, one chart a candidate.

A chart is whole at every place of every timeline where its candidate is shown; plots over a
timeline of Rerun are empty on the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.fits import Fit
from spinpipe.schemas.arrays import F32, F64

PATH = "candidate/registration"
WIDTH, HEIGHT = 16.0, 3.5
BOUNDS = ((-2.6, WIDTH + 0.6), (-0.5, HEIGHT + 0.9))
"""Of the picture, across and downwards: the chart and its numbers."""
_NAME_X, _ABOVE = -1.3, 0.25
_DOT = 0.15
"""Length of what a start is drawn as that tells only how it ended."""


class _Chart(NamedTuple):
    strips: list[F32]
    """(P, 2) each: one a start, the lowest of all last; none where nothing was traced."""
    labels: list[str]
    """Highest and lowest residual, number of steps."""


def draw_courses(rec: rr.RecordingStream, index: list[rr.TimeColumn], fits: Sequence[Fit]) -> None:
    """Log the chart of each fit, one row of ``index`` each; empty where none was traced."""
    charts = [_chart(fit) for fit in fits]
    counts = [len(chart.strips) for chart in charts]
    best = np.cumsum(counts, dtype=int)[np.array(counts) > 0] - 1
    colours = np.concatenate([np.empty((0, 3), np.uint8), *map(palette.series, counts)])
    colours[best] = palette.WHITE
    radii = np.full(len(colours), -0.7)
    radii[best] = -1.5
    lines = rr.LineStrips2D.columns(
        strips=[strip for chart in charts for strip in chart.strips], colors=colours, radii=radii
    )
    rec.send_columns(f"{PATH}/residuals", indexes=index, columns=lines.partition(counts))
    labels = [label for chart in charts for label in chart.labels]
    corners = [(_NAME_X, -_ABOVE), (_NAME_X, HEIGHT - _ABOVE), (WIDTH - 1, HEIGHT)]
    texts = rr.Points2D.columns(
        positions=np.tile(np.array(corners, np.float32), (len(best), 1)),
        labels=labels,
        radii=np.zeros(len(labels)),
        colors=np.tile(np.array(palette.WHITE, np.uint8), (len(labels), 1)),
    )
    shown = [len(chart.labels) for chart in charts]
    rec.send_columns(f"{PATH}/numbers", indexes=index, columns=texts.partition(shown))


def draw_cursor(rec: rr.RecordingStream, fits: Sequence[Fit]) -> None:
    """Log a line that moves along the chart with the steps of the timeline ``candidate``."""
    rows = [step for fit in fits for step in fit.steps]
    x = np.concatenate([_places(fit) for fit in fits])
    strips = np.zeros((len(rows), 2, 2), np.float32)
    strips[:, :, 0] = x[:, None]
    strips[:, 1, 1] = HEIGHT
    rec.log(
        f"{PATH}/now", rr.LineStrips2D.from_fields(colors=palette.MARK, radii=-0.7), static=True
    )
    rec.send_columns(
        f"{PATH}/now",
        indexes=[rr.TimeColumn("candidate", sequence=rows)],
        columns=rr.LineStrips2D.columns(strips=strips),
    )


def _places(fit: Fit) -> F64:
    """(P,) where the steps of a fit are along the chart; the reported pose is at its end."""
    last = max(len(fit.poses) - 3, 0)
    at = np.clip(np.arange(len(fit.poses)) - 1.0, 0, last)
    at[0] = last
    return at * WIDTH / max(last, 1)


def _chart(fit: Fit) -> _Chart:
    """Curves of all starts between their lowest and highest residual."""
    rms = np.empty((0, 0), np.float32) if fit.trace is None else fit.trace.rms_m
    known = np.isfinite(rms)
    if not known.any():
        return _Chart([], [])
    low, high = float(rms[known].min()), float(rms[known].max())
    strips: list[F32] = []
    for curve in (*rms, np.fmin.reduce(rms, axis=0)):
        (at,) = np.nonzero(np.isfinite(curve))
        x = at * WIDTH / max(rms.shape[1] - 1, 1)
        strip = np.column_stack([x, HEIGHT * (high - curve[at]) / max(high - low, 1e-9)])
        if len(strip) == 1:
            strip = np.vstack([strip - (_DOT, 0), strip + (_DOT, 0)])
        if len(strip):
            strips.append(strip.astype(np.float32))
    return _Chart(strips, [f"{high:.3f} m", f"{low:.3f} m", f"{rms.shape[1]} steps"])
