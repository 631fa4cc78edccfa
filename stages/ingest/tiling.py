"""Cutting a cloud into tiles of near points: a balanced k-d split, and one order inside a tile.

Tiles depend on the set of points alone, not on the order in which a file lists them, so the same
cloud saved twice gives the same tiles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F32, F64, I64, U8, U64
from spinpipe.stages.geometry.columns import extremes
from spinpipe.stages.geometry.hashing import GOLDEN
from spinpipe.stages.ingest.point_blocks import MORTON_BITS, descend, hashed, morton_keys

POINT = np.dtype([("xyz", np.float32, 3), ("rgb", np.uint8, 3)])
"""A point on its way to a tile: local frame, metres; colour."""
_SAMPLE_OF_A_LEAF = 4096
"""Points that tell where to cut: the medians' errors add up to 1 / sqrt(2048) or 2 % of a leaf."""


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
        self._keep(xyz, hashed(xyz, GOLDEN))
        while self._count > self._most:
            self._bits += 1
            xyz, hashes = np.concatenate(self._xyz), np.concatenate(self._hashes)
            self._xyz, self._hashes, self._count = [], [], 0
            self._keep(xyz, hashes)

    @property
    def points(self) -> F64:
        """The sample (S, 3) in the order of the hashes: its beginning is a sample too."""
        return np.concatenate(self._xyz)[np.argsort(np.concatenate(self._hashes))]

    def _keep(self, xyz: F64, hashes: U64) -> None:
        if self._bits:
            limit = np.uint64(1 << (64 - self._bits) if self._bits <= 64 else 0)
            kept = np.flatnonzero(hashes < limit)
            xyz, hashes = xyz.take(kept, axis=0), hashes[kept]
        self._xyz.append(xyz)
        self._hashes.append(hashes)
        self._count += len(xyz)


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

    def leaf_of(self, xyz: F32) -> NDArray[np.unsignedinteger]:
        """Leaf (N,) of each of the points (N, 3), in 16 bits where they hold it."""
        leaf = np.empty(len(xyz), np.uint16 if self.depth <= 16 else np.uint32)
        descend(xyz, self.axes, self.cuts, self.depth, leaf)
        return leaf


def kd_split(sample: F32, points: int, tile_points: int) -> KdSplit:
    """Cut space so that each leaf holds about equally many points, fewer than ``tile_points``.

    Medians of the sample make the cuts, so uneven density is no matter. The axis to cut is the one
    along which the middle 90 % of the points reach furthest, so far outliers are none either.

    Parameters
    ----------
    sample : (S, 3) float32
        Stands for the cloud, and so does its beginning; may be empty.
    points : int
        How many points the whole cloud has.
    tile_points : int
        Most points of a tile. Aimed at is 10 % less, because a sample's median is not exact.
    """
    depth = max(0, math.ceil(math.log2(points / (0.9 * tile_points))))
    if points <= tile_points:
        depth = 0
    sample = sample[: _SAMPLE_OF_A_LEAF << depth]
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
    if not len(points):
        return []
    low, high = extremes(points["xyz"])
    if len(points) <= most:
        return [taken(points, _canonical_order(points, low, high))]
    axis = int(np.argmax(high - low))
    others = [points["xyz"][:, (axis + step) % 3] for step in (2, 1, 0)]
    order = np.lexsort((*_colour_keys(points["rgb"]), *others))
    points = taken(points, _without_copies(points, order, np.arange(len(points) - 1)))
    half = len(points) // 2
    return tiles_of(points[:half], most) + tiles_of(points[half:], most)


def taken(points: NDArray[np.void], rows: I64) -> NDArray[np.void]:
    """``points[rows]``, which for records of several fields takes twenty times as long."""
    return points.view(f"V{POINT.itemsize}").take(rows).view(POINT)


def _without_copies(points: NDArray[np.void], order: I64, before: I64) -> I64:
    """Order without those behind places ``before`` whose points equal the ones there."""
    copies = np.ones(len(before), np.bool_)
    for axis in range(3):
        values: F32 = points["xyz"][:, axis]
        copies &= values[order[before + 1]] == values[order[before]]
    return np.delete(order, before[copies] + 1)


def _canonical_order(points: NDArray[np.void], low: F32, high: F32) -> I64:
    """Order along a Morton curve, without copies; points of a cell by coordinates and colour."""
    xyz: F32 = points["xyz"]
    reach = float(np.max(high - low)) or 1.0
    keys = morton_keys(xyz, low, (2**MORTON_BITS - 1) / reach)
    order = np.argsort(keys)
    ordered = keys[order]
    same = ordered[1:] == ordered[:-1]
    if not same.any():
        return order
    tied = np.append(same, False) | np.insert(same, 0, False)
    unsure = order[tied]
    coordinates = tuple(xyz[unsure, axis] for axis in (2, 1, 0))
    colours = _colour_keys(points["rgb"][unsure])
    order[tied] = unsure[np.lexsort((*colours, *coordinates, keys[unsure]))]
    return _without_copies(points, order, np.flatnonzero(same))


def _colour_keys(rgb: U8) -> tuple[U8, U8, U8]:
    return rgb[:, 2], rgb[:, 1], rgb[:, 0]
