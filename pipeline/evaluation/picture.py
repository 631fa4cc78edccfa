"""An evaluation seen from above: the cloud, and what was found, missed and false."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.drawing.sheet import Colour, Sheet
from spinpipe.pipeline.drawing.top_view import TopView, dimmed, top_view
from spinpipe.pipeline.evaluation.report import Evaluation
from spinpipe.pipeline.evaluation.truth import TruthObject
from spinpipe.pipeline.results.instances import ReadTopic
from spinpipe.schemas import CLOUD, SCENE, UPRIGHT
from spinpipe.schemas.arrays import F32, U8
from spinpipe.stages.geometry.frames import to_world

# Three lightnesses and three shapes, so that colour alone decides nothing
FOUND: Colour = (0, 235, 170)
FALSE: Colour = (255, 110, 30)
MISSED: Colour = (255, 120, 235)
NEITHER: Colour = (170, 170, 170)
LEGEND = ((FOUND, "found"), (MISSED, "missed"), (FALSE, "false"), (NEITHER, "not counted"))
DEFAULT_SIZE_M = 2.0
"""Of what is drawn for a missed object where nothing was found to take a size from."""


def write_picture(evaluation: Evaluation, read: ReadTopic, path: Path) -> None:
    """Draw found, missed and false objects over the cloud and write a PNG."""
    view = _view(evaluation, read)
    image = Image.fromarray(dimmed(view.pixels, 0.7))
    _draw(Sheet(image, view), evaluation)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda file: image.save(file, format="PNG"))


def _view(e: Evaluation, read: ReadTopic) -> TopView:
    """What is labelled or accepted, with a margin around it."""
    upright, tiles = read(UPRIGHT)[0], read(CLOUD)
    shown = [t.position[:2] for t in e.truths]
    shown += [d.position_world[:2] for d in e.detections if d.fate in ("accepted", "ambiguous")]
    low, high = np.min(shown, axis=0), np.max(shown, axis=0)
    margin = 0.05 * float((high - low).max()) + 2 * _typical_size(e)[0]

    def pieces() -> Iterator[tuple[F32, U8]]:
        for tile in tiles:
            yield to_world(upright, tile.xyz), tile.rgb

    return top_view(pieces, low - margin, high + margin, coloured=read(SCENE)[0].coloured)


def _typical_size(e: Evaluation) -> tuple[float, float]:
    sizes = [d.size_m[:2] for d in e.detections]
    if not sizes:
        return DEFAULT_SIZE_M, DEFAULT_SIZE_M
    length, width = np.median(sizes, axis=0).tolist()
    return length, width


def _draw(sheet: Sheet, e: Evaluation) -> None:
    score, size = e.accepted, _typical_size(e)
    for truth in e.truths:
        if truth.ignore:
            _draw_truth(sheet, truth, size, NEITHER)
    for i in score.neither:
        sheet.footprint(e.detections[i], NEITHER)
    for match in score.matches:
        sheet.footprint(e.detections[match.detection], FOUND)
    for i in score.false:
        sheet.footprint(e.detections[i], FALSE)
        sheet.cross(e.detections[i], FALSE)
    for i in score.missed:
        _draw_truth(sheet, e.truths[i], size, MISSED)
    counts = (len(score.matches), len(score.missed), len(score.false), None)
    sheet.legend(
        [
            (colour, name if count is None else f"{count} {name}")
            for (colour, name), count in zip(LEGEND, counts, strict=True)
        ]
    )


def _draw_truth(
    sheet: Sheet, truth: TruthObject, size: tuple[float, float], colour: Colour
) -> None:
    """A circle as wide as the object, with its axis where it is known."""
    place, half = np.array(truth.position[:2]), max(size) / 2
    sheet.circle(place, half, colour)
    if truth.axis_deg is not None:
        angle = np.radians(truth.axis_deg)
        along = half * np.array([np.cos(angle), np.sin(angle)])
        sheet.line(np.stack([place - along, place + along]), colour)
