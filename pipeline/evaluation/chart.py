"""Line charts as PNG: a few curves over one axis, readable in black and white too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from spinpipe.pipeline.atomic import write_atomically

Colour = tuple[int, int, int]

WIDTH, HEIGHT = 1200, 720
LEFT, RIGHT, TOP, BOTTOM = 110, 40, 80, 100
INK: Colour = (40, 40, 44)
GRID: Colour = (222, 222, 226)
COLOURS: tuple[Colour, ...] = ((0, 114, 178), (213, 94, 0), (0, 140, 105), (180, 90, 150))
"""Okabe and Ito's, which colour-blind people can tell apart; darker for lines on white."""
MARKS = ("disc", "square", "diamond", "triangle")
TEXT_PX, MARK_PX = 22, 7
TICKS = 6


@dataclass(frozen=True)
class Curve:
    """One line of a chart."""

    name: str
    """Empty: not in the legend."""
    x: Sequence[float]
    y: Sequence[float]
    colour: int = 0
    """Place in ``COLOURS`` and ``MARKS``."""
    dashed: bool = False


@dataclass(frozen=True)
class Chart:
    """Curves with the names of their axes."""

    title: str
    x_name: str
    y_name: str
    curves: Sequence[Curve]
    y_most: float | None = None
    """Values above are drawn at the upper border."""
    level: tuple[float, str] | None = None
    """A horizontal line and what it means."""


def draw_chart(chart: Chart, path: Path) -> None:
    """Write a chart as PNG."""
    image = Image.new("RGB", (WIDTH, HEIGHT), (255, 255, 255))
    _Sheet(image, chart).draw()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda file: image.save(file, format="PNG"))


def round_ticks(low: float, high: float) -> list[float]:
    """About six round numbers (1, 2 or 5 times a power of ten apart) from low to high."""
    rough = max(high - low, 1e-9) / TICKS
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * next(f for f in (1, 2, 5, 10) if f * power >= rough * (1 - 1e-9))
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [round(k * step, 12) for k in range(first, last + 1)]


class _Sheet:
    """Draws one chart."""

    def __init__(self, image: Image.Image, chart: Chart) -> None:
        self._draw = ImageDraw.Draw(image)
        self._image = image
        self._font = ImageFont.load_default(TEXT_PX)
        self._chart = chart
        x = [v for curve in chart.curves for v in curve.x]
        y = [v for curve in chart.curves for v in curve.y] + [0.0]
        y += [chart.level[0]] if chart.level else []
        self._x = (min(x), max(x) if max(x) > min(x) else min(x) + 1)
        top = chart.y_most or max(y) or 1.0
        self._y = (min(0.0, *y), top * (1.0 if chart.y_most else 1.05))

    def draw(self) -> None:
        self._axes()
        if self._chart.level:
            value, name = self._chart.level
            left, y = self._place(self._x[0], value)
            self._line([(left, y), (WIDTH - RIGHT, y)], INK, dashed=True)
            self._draw.text((left + 8, y - TEXT_PX - 6), name, INK, self._font)
        for curve in self._chart.curves:
            points = [self._place(x, y) for x, y in zip(curve.x, curve.y, strict=True)]
            colour = COLOURS[curve.colour % len(COLOURS)]
            self._line(points, colour, dashed=curve.dashed)
            for point in points:
                self._mark(point, colour, MARKS[curve.colour % len(MARKS)], curve.dashed)
        self._legend()

    def _place(self, x: float, y: float) -> tuple[float, float]:
        along = (x - self._x[0]) / (self._x[1] - self._x[0])
        up = (min(y, self._y[1]) - self._y[0]) / (self._y[1] - self._y[0])
        return (
            LEFT + along * (WIDTH - LEFT - RIGHT),
            HEIGHT - BOTTOM - up * (HEIGHT - TOP - BOTTOM),
        )

    def _axes(self) -> None:
        floor = self._y[0]
        for tick in round_ticks(*self._x):
            x, y = self._place(tick, floor)
            self._draw.line((x, y, x, TOP), GRID, 1)
            self._draw.text((x, y + 10), f"{tick:g}", INK, self._font, anchor="ma")
        for tick in round_ticks(*self._y):
            x, y = self._place(self._x[0], tick)
            self._draw.line((x, y, WIDTH - RIGHT, y), GRID, 1)
            self._draw.text((x - 12, y), f"{tick:g}", INK, self._font, anchor="rm")
        corner = self._place(self._x[0], floor)
        self._draw.line((*corner, WIDTH - RIGHT, corner[1]), INK, 2)
        self._draw.line((*corner, corner[0], TOP), INK, 2)
        middle = (LEFT + WIDTH - RIGHT) / 2
        self._draw.text((middle, HEIGHT - 20), self._chart.x_name, INK, self._font, anchor="ms")
        self._draw.text((middle, 16), self._chart.title, INK, self._font, anchor="ma")
        self._draw.text((16, TOP - 34), self._chart.y_name, INK, self._font)

    def _line(self, points: list[tuple[float, float]], colour: Colour, *, dashed: bool) -> None:
        if not dashed:
            self._draw.line(points, colour, 3, joint="curve")
            return
        for (x0, y0), (x1, y1) in pairwise(points):
            length = float(np.hypot(x1 - x0, y1 - y0))
            for begin in np.arange(0.0, length, 16.0):
                a, b = begin / length, min(begin + 9.0, length) / length
                ends = (x0 + a * (x1 - x0), y0 + a * (y1 - y0))
                self._draw.line((*ends, x0 + b * (x1 - x0), y0 + b * (y1 - y0)), colour, 3)

    def _mark(self, at: tuple[float, float], colour: Colour, kind: str, hollow: bool) -> None:
        (x, y), r = at, MARK_PX
        fill = (255, 255, 255) if hollow else colour
        if kind == "disc":
            self._draw.ellipse((x - r, y - r, x + r, y + r), fill, colour, 3)
            return
        corners = {
            "square": [(-r, -r), (r, -r), (r, r), (-r, r)],
            "diamond": [(0, -1.4 * r), (1.4 * r, 0), (0, 1.4 * r), (-1.4 * r, 0)],
            "triangle": [(0, -1.3 * r), (1.3 * r, r), (-1.3 * r, r)],
        }[kind]
        self._draw.polygon([(x + dx, y + dy) for dx, dy in corners], fill, colour, 3)

    def _legend(self) -> None:
        """Names in a row above the curves, where they hide nothing."""
        x, y = float(WIDTH - RIGHT), TOP - 22.0
        for curve in reversed([c for c in self._chart.curves if c.name]):
            x -= self._font.getlength(curve.name)
            self._draw.text((x, y), curve.name, INK, self._font, anchor="lm")
            colour = COLOURS[curve.colour % len(COLOURS)]
            self._line([(x - 54, y), (x - 10, y)], colour, dashed=curve.dashed)
            self._mark((x - 32, y), colour, MARKS[curve.colour % len(MARKS)], curve.dashed)
            x -= 80
