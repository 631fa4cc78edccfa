"""Cutting a cloud into tiles of near points: a balanced k-d split, and one order inside a tile.

Tiles depend on the set of points alone, not on the order in which a file lists them, so the same
cloud saved twice gives the same tiles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F32, F64, I64, U8, U64, Mask
from spinpipe.stages.geometry.columns import extremes
from spinpipe.stages.geometry.hashing import GOLDEN, mix

POINT = np.dtype([("xyz", np.float32, 3), ("rgb", np.uint8, 3)])
"""A point on its way to a tile: local frame, metres; colour."""


class HashSample:
    """A sample of a stream of points that depends neither on their order nor on the chunks.

    A point is kept when a hash of its coordinates is below a limit; the limit is halved whenever
    more than ``most`` points are kept.

    Parameters
    ----------
    most : int
        Upper bound of the sample's size; it ends between half of it and all of it, or smaller
        where the stream is shorter or many points coincide.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._bits = 0
        self._xyz: list[F64] = [np.empty((0, 3))]
        self._hashes: list[U64] = [np.empty(0, np.uint64)]
        self._count = 0

    def add(self, xyz: F64) -> None:
        """Offer points (N, 3), finite."""
        hashes = _hashed(xyz)
        kept = self._below(hashes)
        self._xyz.append(xyz[kept])
        self._hashes.append(hashes[kept])
        self._count += len(self._hashes[-1])
        while self._count > self._most:
            self._bits += 1
            hashes = np.concatenate(self._hashes)
            kept = self._below(hashes)
            self._xyz = [self.points[kept]]
            self._hashes = [hashes[kept]]
            self._count = len(self._hashes[0])

    @property
    def points(self) -> F64:
        """The sample (S, 3)."""
        return np.concatenate(self._xyz)

    def _below(self, hashes: U64) -> Mask:
        if self._bits >= 64:
            return np.zeros(len(hashes), np.bool_)
        return hashes <= np.uint64((1 << (64 - self._bits)) - 1)


def _hashed(xyz: F64) -> U64:
    """64-bit hashes of coordinates."""
    state = np.zeros(len(xyz), np.uint64)
    for axis in range(3):
        # adding 0.0 turns -0.0, which equals 0.0, into the same bits
        state += np.ascontiguousarray(xyz[:, axis] + 0.0).view(np.uint64)
        state = mix(state + GOLDEN)
    return state


@dataclass(frozen=True)
class KdSplit:
    """A complete binary tree of axis-aligned cuts; leaf i is the i-th from the left."""

    axes: I64
    """(nodes,) axis that node i cuts; its children are nodes 2 i + 1 and 2 i + 2."""
    cuts: F32
    """(nodes,) a point goes right where its coordinate is at least this; infinite: no cut."""
    depth: int

    @property
    def leaves(self) -> int:
        """How many leaves there are; some may hold no point."""
        return 1 << self.depth

    def leaf_of(self, xyz: F32) -> I64:
        """Leaf (N,) of each of the points (N, 3)."""
        node = np.zeros(len(xyz), np.int64)
        rows = np.arange(len(xyz))
        for _ in range(self.depth):
            node = 2 * node + 1 + (xyz[rows, self.axes[node]] >= self.cuts[node])
        return node - (self.leaves - 1)


def kd_split(sample: F32, points: int, tile_points: int) -> KdSplit:
    """Cut space so that each leaf holds about equally many points, fewer than ``tile_points``.

    Medians of the sample make the cuts, so uneven density is no matter. The axis to cut is the one
    along which the middle 90 % of the points reach furthest, so far outliers are none either.

    Parameters
    ----------
    sample : (S, 3) float32
        Stands for the cloud; may be empty.
    points : int
        How many points the whole cloud has.
    tile_points : int
        Most points of a tile. Aimed at is 10 % less, because a sample's median is not exact.
    """
    depth = max(0, math.ceil(math.log2(points / (0.9 * tile_points))))
    if points <= tile_points:
        depth = 0
    nodes = (1 << depth) - 1
    axes = np.zeros(nodes, np.int64)
    cuts = np.full(nodes, np.inf, np.float32)
    parts = {0: sample}
    for node in range(nodes):
        part = parts.pop(node)
        low, high = part, part[:0]
        cut = _best_cut(part)
        if cut is not None:
            axes[node], cuts[node] = cut
            right = part[:, axes[node]] >= cuts[node]
            low, high = part[~right], part[right]
        parts[2 * node + 1], parts[2 * node + 2] = low, high
    return KdSplit(axes, cuts, depth)


def _best_cut(part: F32) -> tuple[int, np.float32] | None:
    """Axis and coordinate that halve the points; None where all coincide."""
    if len(part) < 2:
        return None
    low, middle, high = np.quantile(part, (0.05, 0.5, 0.95), axis=0, method="nearest")
    if not (high > low).any():
        low, high = part.min(axis=0), part.max(axis=0)
    axis = int(np.argmax(high - low))
    values = part[:, axis]
    above = values > values.min()
    if not above.any():
        return None
    # At least the lowest points stay left, even where the median is the lowest value
    return axis, max(middle[axis], values[above].min())


def tiles_of(points: NDArray[np.void], most: int) -> list[NDArray[np.void]]:
    """Cut the points of one leaf into tiles of at most ``most`` points, each in canonical order.

    Of points with equal coordinates one stays: copies say nothing of the surface.

    Parameters
    ----------
    points : (N,) of dtype ``POINT``
    most : int
        Points of the largest tile, at least 1.
    """
    if len(points) <= most:
        return [_without_copies(points[_canonical_order(points)])] if len(points) else []
    low, high = extremes(points["xyz"])
    axis = int(np.argmax(high - low))
    others = [points["xyz"][:, (axis + step) % 3] for step in (2, 1, 0)]
    order = np.lexsort((*_colour_keys(points["rgb"]), *others))
    points = _without_copies(points[order])
    half = len(points) // 2
    return tiles_of(points[:half], most) + tiles_of(points[half:], most)


def _without_copies(points: NDArray[np.void]) -> NDArray[np.void]:
    """Ordered points of which equal ones are neighbours, without all but the first of these."""
    xyz: F32 = points["xyz"]
    x, y, z = (xyz[1:] == xyz[:-1]).T
    copies = np.append(False, x & y & z)
    return points[~copies] if copies.any() else points


def _canonical_order(points: NDArray[np.void]) -> I64:
    """Order along a Morton curve [Morton 1966]; points in one cell by coordinates and colour."""
    xyz: F32 = points["xyz"]
    low, high = extremes(xyz)
    reach = float(np.max(high - low)) or 1.0
    cells = ((xyz - low).astype(np.float64) * ((2**21 - 1) / reach)).astype(np.uint64)
    keys = _spread(cells[:, 0]) | _spread(cells[:, 1]) << np.uint64(1) | _spread(cells[:, 2]) << 2
    order = np.argsort(keys)
    ordered = keys[order]
    same = ordered[1:] == ordered[:-1]
    tied = np.append(same, False) | np.insert(same, 0, False)
    if tied.any():
        unsure = order[tied]
        coordinates = tuple(xyz[unsure, axis] for axis in (2, 1, 0))
        colours = _colour_keys(points["rgb"][unsure])
        order[tied] = unsure[np.lexsort((*colours, *coordinates, keys[unsure]))]
    return order


def _spread(cells: U64) -> U64:
    """Move bit i of 21-bit numbers to bit 3 i."""
    masks = (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    )
    for shift, mask in masks:
        cells = (cells | cells << np.uint64(shift)) & np.uint64(mask)
    return cells


def _colour_keys(rgb: U8) -> tuple[U8, U8, U8]:
    return rgb[:, 2], rgb[:, 1], rgb[:, 0]
