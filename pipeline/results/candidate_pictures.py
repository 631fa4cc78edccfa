"""Small pictures of candidates for the report: one sheet, a row of views for each candidate."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.closeup import SIGHT, WHAT, Closeup
from spinpipe.schemas.arrays import F64, U8

POINTS = 4000
"""Of the cloud in a picture."""
SIDE_PX = 112
EMPTY_M = 1.0
"""Shown around a candidate where nothing stands, to each side."""
VIEWS = ("from above, as photographed", "from the side, explained or not", "model, seen or not")
COLUMNS = 6
"""Candidates side by side."""
ENLARGED = 4
"""Pixels of a picture by itself for one in a sheet."""

WHAT_COLOURS = np.array(
    [palette.GROUND_POINT, palette.EXPLAINED, palette.UNEXPLAINED, palette.SHADOW], np.uint8
)
SIGHT_COLOURS = np.array([palette.SEEN, palette.CONTRADICTED, palette.NOT_OBSERVED], np.uint8)
assert len(WHAT_COLOURS) == len(WHAT)
assert len(SIGHT_COLOURS) == len(SIGHT)


def sprite_sheet(closeups: Iterable[Closeup]) -> tuple[bytes, int]:
    """A JPEG of all candidates' views, row by row, and how many candidates it holds."""
    tiles = [np.hstack(_views(closeup)) for closeup in closeups]
    if not tiles:
        return b"", 0
    buffer = BytesIO()
    Image.fromarray(_in_rows(tiles, COLUMNS)).save(buffer, format="JPEG", quality=80)
    return buffer.getvalue(), len(tiles)


def strips(closeups: Iterable[Closeup]) -> Image.Image:
    """Candidates below each other, at least one: the three ``VIEWS`` of each side by side."""
    small = Image.fromarray(_in_rows([np.hstack(_views(closeup)) for closeup in closeups], 1))
    return small.resize((small.width * ENLARGED, small.height * ENLARGED), Image.Resampling.NEAREST)


def _in_rows(tiles: list[U8], columns: int) -> U8:
    tiles = tiles + [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    return np.vstack([np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)])


def _views(c: Closeup) -> list[U8]:
    """Squares (SIDE_PX, SIDE_PX, 3): from above, from the side, the model's surface from above."""
    length, width, height = c.detection.size_m
    reach = 0.5 * length + 0.3 * max(length, width) or EMPTY_M  # no size where nothing stands
    scale = SIDE_PX / (2 * reach)
    rising = np.argsort(c.xyz[:, 2], kind="stable")
    above = _plot(c.xyz[rising, 0], c.xyz[rising, 1], c.rgb[rising], scale)
    box = [(length / 2, width / 2), (-length / 2, width / 2)]
    box += [(-x, -y) for x, y in box] + [box[0], (length / 2, 0), (length / 4, 0)]
    _line(above, np.array(box), scale, palette.fate_colour(c.detection.fate)[:3])
    near = abs(c.xyz[:, 1]) < width / 2 + 0.2 * width
    order = np.argsort(-c.xyz[near, 1], kind="stable")
    xz, what = c.xyz[near][order], c.what[near][order]
    side = _plot(xz[:, 0], xz[:, 2] - height / 2, WHAT_COLOURS[what], scale)
    up = np.argsort(c.surface[:, 2], kind="stable")
    seen = SIGHT_COLOURS[c.sight[up]]
    model = _plot(c.surface[up, 0], c.surface[up, 1], seen, scale, dot=max(2, SIDE_PX // 40))
    return [above, side, model]


def _plot(across: NDArray[Any], up: NDArray[Any], colours: U8, scale: float, dot: int = 2) -> U8:
    """Dots of points; the last one drawn is on top."""
    picture = np.full((SIDE_PX, SIDE_PX, 3), palette.BACKGROUND, np.uint8)
    column = np.floor(SIDE_PX / 2 + np.asarray(across) * scale).astype(int)
    row = np.floor(SIDE_PX / 2 - np.asarray(up) * scale).astype(int)
    for i in range(dot):
        for j in range(dot):
            r, c = row + i, column + j
            inside = (r >= 0) & (r < SIDE_PX) & (c >= 0) & (c < SIDE_PX)
            picture[r[inside], c[inside]] = colours[inside]
    return picture


def _line(picture: U8, xy: F64, scale: float, colour: tuple[int, ...]) -> None:
    """Lines through points (N, 2) of the view from above."""
    for a, b in pairwise(xy):
        steps = int(np.abs(b - a).max() * scale) + 2
        line = a + (b - a) * np.linspace(0, 1, steps)[:, None]
        column = np.clip((SIDE_PX / 2 + line[:, 0] * scale).astype(int), 0, SIDE_PX - 1)
        row = np.clip((SIDE_PX / 2 - line[:, 1] * scale).astype(int), 0, SIDE_PX - 1)
        picture[row, column] = colour
