"""An evaluation seen from above: the cloud, and what was found, missed and false."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.evaluation.report import Evaluation
from spinpipe.pipeline.evaluation.top_view import TopView, dimmed, top_view
from spinpipe.pipeline.evaluation.truth import TruthObject
from spinpipe.pipeline.export import ReadTopic
from spinpipe.schemas import CLOUD, SCENE, UPRIGHT
from spinpipe.schemas.records import F32, F64, U8, Detection
from spinpipe.stages.geometry.frames import to_world

Colour = tuple[int, int, int]

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
    _Sheet(image, view).draw_evaluation(evaluation)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda file: image.save(file, format="PNG"))


def _view(e: Evaluation, read: ReadTopic) -> TopView:
    """What is labelled or accepted, with a margin around it."""
    upright, tiles = read(UPRIGHT)[0], read(CLOUD)
    shown = [t.position[:2] for t in e.truths]
    shown += [d.position_world[:2] for d in e.detections if d.fate != "rejected"]
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


class _Sheet:
    """Draws in world coordinates on the picture."""

    def __init__(self, image: Image.Image, view: TopView) -> None:
        self._draw = ImageDraw.Draw(image)
        self._view = view
        self._image = image
        self._text_px = max(12, image.width // 80)
        self._font = ImageFont.load_default(self._text_px)

    def draw_evaluation(self, e: Evaluation) -> None:
        score = e.accepted
        for truth in e.truths:
            if truth.ignore:
                self._object(truth, _typical_size(e), NEITHER)
        for i in score.neither:
            self._detection(e.detections[i], NEITHER)
        for match in score.matches:
            self._detection(e.detections[match.detection], FOUND)
        for i in score.false:
            self._detection(e.detections[i], FALSE)
            self._cross(e.detections[i])
        for i in score.missed:
            self._object(e.truths[i], _typical_size(e), MISSED)
        self._legend(len(score.matches), len(score.missed), len(score.false))

    def _detection(self, d: Detection, colour: Colour) -> None:
        """Footprint with a tick at the front."""
        length, width = d.size_m[0] / 2, d.size_m[1] / 2
        corners = [(length, width), (-length, width), (-length, -width), (length, -width)]
        self._outline(d, corners, colour)
        self._polyline(d, [(length / 2, 0.0), (length, 0.0)], colour)

    def _cross(self, d: Detection) -> None:
        length, width = d.size_m[0] / 2, d.size_m[1] / 2
        self._polyline(d, [(length, width), (-length, -width)], FALSE)
        self._polyline(d, [(length, -width), (-length, width)], FALSE)

    def _object(self, truth: TruthObject, size: tuple[float, float], colour: Colour) -> None:
        """A circle as wide as the object, with its axis where it is known."""
        place = np.array([truth.position[:2]])
        (x, y), radius = self._view.place(place)[0], max(size) / 2 / self._view.pixel_m
        self._draw.ellipse((x - radius, y - radius, x + radius, y + radius), None, colour, 3)
        if truth.axis_deg is not None:
            angle = np.radians(truth.axis_deg)
            along = max(size) / 2 * np.array([np.cos(angle), np.sin(angle)])
            self._line(np.stack([place[0] - along, place[0] + along]), colour)

    def _outline(self, d: Detection, corners: list[tuple[float, float]], colour: Colour) -> None:
        self._polyline(d, [*corners, corners[0]], colour)

    def _polyline(self, d: Detection, points: list[tuple[float, float]], colour: Colour) -> None:
        """Lines in the object's own plane."""
        angle = np.radians(d.heading_deg)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        self._line(np.array(points) @ turn.T + d.position_world[:2], colour)

    def _line(self, xy: F64, colour: Colour) -> None:
        self._draw.line([(c, r) for c, r in self._view.place(xy).tolist()], fill=colour, width=3)

    def _legend(self, found: int, missed: int, false: int) -> None:
        x = y = self._text_px // 2
        for (colour, name), count in zip(LEGEND, (found, missed, false, None), strict=True):
            text = name if count is None else f"{count} {name}"
            box = self._draw.textbbox((x, y), text, self._font)
            self._draw.rectangle((box[0] - 4, box[1] - 4, box[2] + 4, box[3] + 4), (0, 0, 0))
            self._draw.text((x, y), text, colour, self._font)
            x = int(box[2]) + self._text_px
        self._scale_bar()

    def _scale_bar(self) -> None:
        """A bar of a round length, about a tenth of the picture."""
        about_m = self._image.width * self._view.pixel_m / 10
        length_m = 10.0 ** np.floor(np.log10(about_m))
        length_m *= max(f for f in (1, 2, 5) if f * length_m <= about_m)
        left, bottom = self._text_px, self._image.height - self._text_px
        right = left + length_m / self._view.pixel_m
        self._draw.line((left, bottom, right, bottom), fill=(255, 255, 255), width=4)
        self._draw.text(
            (left, bottom - 1.5 * self._text_px), f"{length_m:g} m", (255, 255, 255), self._font
        )
