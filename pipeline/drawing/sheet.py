"""Drawing in world coordinates over a cloud seen from above."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from spinpipe.pipeline.drawing.top_view import TopView
from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import Detection

Colour = tuple[int, int, int]
WHITE: Colour = (255, 255, 255)
BLACK: Colour = (0, 0, 0)


class Sheet:
    """Draws lines, footprints and labels on a picture."""

    def __init__(self, image: Image.Image, view: TopView) -> None:
        self._draw = ImageDraw.Draw(image)
        self._view = view
        self._image = image
        self._text_px = max(12, image.width // 80)
        self._font = ImageFont.load_default(self._text_px)
        self._taken: list[tuple[float, float, float, float]] = []

    def footprint(self, d: Detection, colour: Colour, width: int = 3) -> None:
        """Outline with a tick at the front."""
        length, wide = d.size_m[0] / 2, d.size_m[1] / 2
        corners = [(length, wide), (-length, wide), (-length, -wide), (length, -wide)]
        self._polyline(d, [*corners, corners[0]], colour, width)
        self._polyline(d, [(length / 2, 0.0), (length, 0.0)], colour, width)

    def cross(self, d: Detection, colour: Colour, share: float = 1.0, width: int = 3) -> None:
        """Diagonals of a share of the footprint."""
        length, wide = share * d.size_m[0] / 2, share * d.size_m[1] / 2
        self._polyline(d, [(length, wide), (-length, -wide)], colour, width)
        self._polyline(d, [(length, -wide), (-length, wide)], colour, width)

    def circle(self, place: F64, radius_m: float, colour: Colour) -> None:
        """A circle around a place (2,)."""
        (x, y), radius = self._view.place(place[None])[0], radius_m / self._view.pixel_m
        self._draw.ellipse((x - radius, y - radius, x + radius, y + radius), None, colour, 3)

    def line(self, xy: F64, colour: Colour, width: int = 3) -> None:
        """A line through places (N, 2)."""
        points = [(c, r) for c, r in self._view.place(xy).tolist()]
        self._draw.line(points, fill=colour, width=width)

    def label(self, d: Detection, text: str, colour: Colour) -> bool:
        """Write beside a footprint where no other label is; ``False`` if there is no room."""
        place = np.array([d.position_world[:2]])
        x, y = self._view.place(place)[0].tolist()
        reach = float(np.hypot(*d.size_m[:2])) / 2 / self._view.pixel_m
        wide, high = self._font.getlength(text) + 6, self._text_px + 6
        near, far = min(d.size_m[:2]) / 2 / self._view.pixel_m, reach
        for distance in (near, (near + far) / 2, far, 1.5 * far, 2.2 * far):
            for angle in np.radians([90, 0, 180, 270, 45, 135, 225, 315]):
                cx = x + np.cos(angle) * (distance + wide / 2)
                cy = y - np.sin(angle) * (distance + high / 2)
                box = (cx - wide / 2, cy - high / 2, cx + wide / 2, cy + high / 2)
                if self._free(box):
                    self._taken.append(box)
                    self._draw.rectangle(box, BLACK)
                    self._draw.text((cx, cy), text, colour, self._font, anchor="mm")
                    return True
        return False

    def legend(self, entries: Sequence[tuple[Colour, str]]) -> None:
        """Coloured names in a row at the top, and a bar of a round length at the bottom."""
        x = y = self._text_px // 2
        for colour, text in entries:
            box = self._draw.textbbox((x, y), text, self._font)
            self._draw.rectangle((box[0] - 4, box[1] - 4, box[2] + 4, box[3] + 4), BLACK)
            self._draw.text((x, y), text, colour, self._font)
            x = int(box[2]) + self._text_px
        self._scale_bar()

    def _free(self, box: tuple[float, float, float, float]) -> bool:
        if box[0] < 0 or box[1] < 0 or box[2] > self._image.width or box[3] > self._image.height:
            return False
        return all(
            box[2] < b[0] or box[0] > b[2] or box[3] < b[1] or box[1] > b[3] for b in self._taken
        )

    def _polyline(
        self, d: Detection, points: list[tuple[float, float]], colour: Colour, width: int
    ) -> None:
        """Lines in the object's own plane."""
        angle = np.radians(d.heading_deg)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        self.line(np.array(points) @ turn.T + d.position_world[:2], colour, width)

    def _scale_bar(self) -> None:
        about_m = self._image.width * self._view.pixel_m / 10
        length_m = 10.0 ** np.floor(np.log10(about_m))
        length_m *= max(f for f in (1, 2, 5) if f * length_m <= about_m)
        left, bottom = self._text_px, self._image.height - self._text_px
        right = left + length_m / self._view.pixel_m
        self._draw.line((left, bottom, right, bottom), fill=WHITE, width=4)
        text = f"{length_m:g} m"
        self._draw.text((left, bottom - 1.5 * self._text_px), text, WHITE, self._font)
