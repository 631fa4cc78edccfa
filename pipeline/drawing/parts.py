"""Draw the parts of a score as bars beside those of a right instance, the score by its limit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.schemas.arrays import F32, U8
from spinpipe.schemas.records import Detection

PATH = "candidate/parts"
LENGTH = 10.0
"""Of a bar of 1; rows are 1 apart."""
BOUNDS = ((-3.8, 17.8), (-0.8, 6.8))
"""Of the picture, across and downwards: six parts and the score."""
COSTLY = 2.0
"""Loss of log odds from which a part is coloured as the rejected are."""
_BAR, _MARK, _TRACK = 0.3, 0.07, 0.04
_NAME_X, _NUMBER_X, _ABOVE = -2.0, 14.0, 0.55
"""Places of the texts; they hang below their points."""


class _Row(NamedTuple):
    name: str
    value: float
    limit: float
    colour: palette.Colour
    text: str


def draw_parts(
    rec: rr.RecordingStream, index: list[rr.TimeColumn], detections: Sequence[Detection]
) -> None:
    """Log the bars of each detection, one row of ``index`` each."""
    rows = [_rows(d) for d in detections]
    every = [(i, row) for own in rows for i, row in enumerate(own)]
    counts = np.array([len(own) for own in rows])
    strips = np.concatenate(
        [np.empty((0, 2, 2), np.float32), *(_strips(i, row) for i, row in every)]
    )
    radii = np.tile([_TRACK, _BAR, _MARK], len(every))
    colours: U8 = np.array(
        [c for _, row in every for c in (palette.SHADOW, row.colour[:3], palette.WHITE)], np.uint8
    )
    lines = rr.LineStrips2D.columns(strips=strips, colors=colours, radii=radii)
    rec.send_columns(f"{PATH}/bars", indexes=index, columns=lines.partition(3 * counts))
    places = np.array([(x, i - _ABOVE) for i, _ in every for x in (_NAME_X, _NUMBER_X)])
    labels = [text for _, row in every for text in (row.name, row.text)]
    points = rr.Points2D.columns(
        positions=places,
        labels=labels,
        radii=np.zeros(len(labels)),
        colors=np.tile(np.array(palette.WHITE, np.uint8), (len(labels), 1)),
    )
    rec.send_columns(f"{PATH}/text", indexes=index, columns=points.partition(2 * counts))


def _rows(d: Detection) -> list[_Row]:
    rows = [
        _Row(
            p.name,
            p.value,
            p.reference,
            _by_cost(p.merit),
            f"{p.value:.2f} / {p.reference:.2f}  {p.merit:+.1f}",
        )
        for p in d.parts
    ]
    text = f"{d.score:.2f}, needs {d.min_score:g}"
    return [*rows, _Row("score", d.score, d.min_score, palette.fate_colour(d.fate), text)]


def _by_cost(merit: float) -> palette.Colour:
    """From the colour of the accepted to that of the rejected as a part costs more."""
    share = min(max(-merit / COSTLY, 0.0), 1.0)
    good, bad = np.array(palette.ACCEPTED), np.array(palette.CONTRADICTED)
    return tuple(int(c) for c in good + share * (bad - good))


def _strips(i: int, row: _Row) -> F32:
    """Track, bar and mark (3, 2, 2) of the i-th row."""
    value, limit = (LENGTH * min(max(x, 0.0), 1.0) for x in (row.value, row.limit))
    track, bar = [(0.0, i), (LENGTH, i)], [(0.0, i), (value, i)]
    return np.array([track, bar, [(limit, i - 0.45), (limit, i + 0.45)]], np.float32)
