"""A cloud seen from straight above, as a picture."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F32, F64, U8, Mask
from spinpipe.schemas.colormap import viridis

BACKGROUND = (24, 24, 27)


@dataclass(frozen=True)
class TopView:
    """A picture of the world's x-y plane: x to the right, y upwards."""

    pixels: U8
    """(H, W, 3), first row at the largest y."""
    low: F64
    """(2,) world x and y at the lower left corner, metres."""
    pixel_m: float

    def place(self, xy: F64) -> F64:
        """Pixel coordinates (N, 2), column and row, of world points (N, 2)."""
        columns = (xy[:, 0] - self.low[0]) / self.pixel_m
        rows = len(self.pixels) - (xy[:, 1] - self.low[1]) / self.pixel_m
        return np.column_stack([columns, rows])


def top_view(
    tiles: Callable[[], Iterable[tuple[F32, U8]]],
    low: F64,
    high: F64,
    *,
    coloured: bool,
    width: int = 1600,
) -> TopView:
    """Draw the highest point of every pixel, in its own colour or coloured by height.

    Parameters
    ----------
    tiles : gives (xyz (N, 3) world, rgb (N, 3)) of each piece of the cloud, anew at every call.
    low, high : (2,) corners of what is shown at most, metres; cut down to where points are.
    coloured : whether to use the points' own colours.
    width : of the longer side, pixels.
    """
    points, low, high = _occupied(tiles(), low, high)
    size = np.maximum(high - low, 1e-6)
    pixel_m = float(size.max()) / width
    # Sparse clouds are drawn with larger dots: twice the spacing of the points leaves few gaps
    spacing_m = float(np.sqrt(size.prod() / max(points, 1)))
    dot = max(1, min(width // 100, round(1.5 * spacing_m / pixel_m)))
    dots = np.maximum(np.ceil(size / (pixel_m * dot)).astype(int), 1)
    top = np.full(dots.prod(), -np.inf, np.float32)
    colour = np.full((dots.prod(), 3), BACKGROUND, np.uint8)
    for everything, colours in tiles():
        shown = _inside(everything, low, high)
        xyz, rgb = everything[shown], colours[shown]
        cell = np.minimum(((xyz[:, :2] - low) / (pixel_m * dot)).astype(np.int64), dots - 1)
        # Sorted by height the highest comes last, and the last one written stays
        rising = np.argsort(xyz[:, 2], kind="stable")
        flat = cell[rising, 1] * dots[0] + cell[rising, 0]
        higher = xyz[rising, 2] > top[flat]
        flat, rising = flat[higher], rising[higher]
        top[flat] = xyz[rising, 2]
        colour[flat] = rgb[rising]
    if not coloured:
        seen = np.isfinite(top)
        colour[seen] = _by_height(top[seen])
    picture = _without_gaps(top.reshape(dots[::-1]), colour.reshape(dots[1], dots[0], 3))[::-1]
    large = np.repeat(np.repeat(picture, dot, axis=0), dot, axis=1)
    return TopView(large, np.asarray(low, np.float64), pixel_m)


def _inside(xyz: F32, low: F64, high: F64) -> Mask:
    return np.all((xyz[:, :2] >= low) & (xyz[:, :2] <= high), axis=1)


def _occupied(tiles: Iterable[tuple[F32, U8]], low: F64, high: F64) -> tuple[int, F64, F64]:
    """Number and bounds of the points that are shown."""
    count, least, most = 0, np.full(2, np.inf), np.full(2, -np.inf)
    for everything, _ in tiles:
        xy = everything[_inside(everything, low, high), :2]
        if len(xy):
            count += len(xy)
            least, most = np.minimum(least, xy.min(axis=0)), np.maximum(most, xy.max(axis=0))
    return (count, least, most) if count else (0, low, high)


def _without_gaps(top: F32, colour: U8) -> U8:
    """Fill single empty dots with the highest of their neighbours."""
    height, wide = top.shape
    padded = np.pad(top, 1, constant_values=-np.inf)
    colours = np.pad(colour, ((1, 1), (1, 1), (0, 0)), mode="edge")
    filled, best = colour.copy(), np.full_like(top, -np.inf)
    empty = ~np.isfinite(top)
    for row, column in np.ndindex(3, 3):
        around = padded[row : row + height, column : column + wide]
        better = empty & (around > best)
        best[better] = around[better]
        filled[better] = colours[row : row + height, column : column + wide][better]
    return filled


def _by_height(z: F32) -> U8:
    if not len(z):
        return np.empty((0, 3), np.uint8)
    least, most = np.percentile(z, [2, 98])
    return viridis(z, float(least), max(float(most), float(least) + 1e-6))


def dimmed(pixels: U8, share: float) -> U8:
    """Darken a picture so that what is drawn over it stands out."""
    return (pixels * share).astype(np.uint8)
