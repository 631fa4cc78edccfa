"""A first pass over a scene: how far it reaches, what lies astray, how finely it is written."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F64, U8, Mask
from spinpipe.schemas.records import Vector
from spinpipe.stages.geometry.columns import extremes
from spinpipe.stages.ingest.point_blocks import finite_rows
from spinpipe.stages.ingest.readers.scene_source import SceneSource
from spinpipe.stages.ingest.tiling import HashSample
from spinpipe.stages.stage import Progress, StageError

TAIL_SHARE = 0.01
"""Share of the points at either end of an axis that may be astray."""
FEWEST_FOR_TAILS = 20
"""Of fewer points none is astray: there is no rest to be far from."""
GAP = 0.5
"""Points behind a gap this wide are astray, as a share of the body's longest side."""
FARTHEST = 10.0
"""So are those farther from the body than this many of its longest sides, gap or not."""
GROUP_SHARE = 0.1
"""And so are up to as many, as cells without data are (-9999), behind a gap of ``FARTHEST``."""
_STEP_POINTS = 100_000
_SPACING_POINTS = 4000
_NEIGHBOURS = 8


@dataclass(frozen=True)
class Survey:
    """What the first pass finds out, in the scene frame and its units."""

    points: int
    """With finite coordinates."""
    dropped: int
    """Without."""
    strays: int
    """Of the points, those outside ``keep_low`` .. ``keep_high``."""
    keep_low: F64
    """(3,) corner of the box outside which points are astray."""
    keep_high: F64
    low: F64
    """(3,) least coordinates of what is not astray."""
    high: F64
    sample: F64
    """(S, 3) of what is not astray, in random order but whatever that of the file; of equal points
    there is one."""
    share: float
    """Of the points that the sample was drawn with, copies among them."""

    @property
    def origin(self) -> Vector:
        """Median of the sample in whole units."""
        middle = np.median(self.sample, axis=0) if len(self.sample) else self.low
        x, y, z = (np.rint(middle) + 0.0).tolist()
        return x, y, z

    @property
    def steps(self) -> Vector:
        """Grid that the coordinates lie on along each axis; 0 where there is none to be seen."""
        x, y, z = (_step(np.unique(column)) for column in self.sample[:_STEP_POINTS].T)
        return x, y, z

    @property
    def single_precision(self) -> bool:
        """Whether the coordinates are those of 32-bit floats."""
        return bool((self.sample == self.sample.astype(np.float32)).all())

    def spacing(self, scale: Vector) -> float:
        """Typical distance of neighbours on a surface in metres; 0 for less than ten places.

        A disc about a point that reaches to its k-th neighbour holds k points.
        """
        places = (self.sample - self.sample[:1]) * scale
        if len(places) <= _NEIGHBOURS:
            return 0.0
        some = places[:_SPACING_POINTS]
        tree = KDTree(places, compact_nodes=False, balanced_tree=False)
        reach = tree.query(some, k=_NEIGHBOURS + 1)[0][:, _NEIGHBOURS]
        return float(np.median(reach) * np.sqrt(np.pi / _NEIGHBOURS * self.share))


def survey(source: SceneSource, name: str, chunk: int, progress: Progress) -> Survey:
    """Read a scene once.

    Parameters
    ----------
    source : the scene.
    name : of it, for messages.
    chunk : points to read at once.
    progress : counts them.

    Raises
    ------
    StageError
        When there is no point, or none with finite coordinates.
    """
    sample = HashSample(chunk)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    points = read = 0
    for block in finite(source, chunk):
        progress.advance(block.read)
        read += block.read
        points += len(block.xyz)
        sample.add(block.xyz)
        low, high = np.minimum(low, block.low), np.maximum(high, block.high)
    if not read:
        raise StageError(f"{name}: the cloud is empty; export it again")
    if not points:
        raise StageError(
            f"{name}: none of its {read:,} points has finite coordinates; export it again"
        )
    drawn = sample.points
    copies = (drawn[1:] == drawn[:-1]).all(axis=1)
    known = drawn[~np.append(False, copies)] if copies.any() else drawn
    known = known if len(known) else np.stack([low, high])
    keep_low, keep_high = kept_box(known)
    strays = 0
    if (low < keep_low).any() or (high > keep_high).any():
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for block in finite(source, chunk):
            kept = block.xyz[within(block.xyz, keep_low, keep_high)]
            strays += len(block.xyz) - len(kept)
            if len(kept):
                lowest, highest = extremes(kept)
                low, high = np.minimum(low, lowest), np.maximum(high, highest)
        known = known[within(known, keep_low, keep_high)]
    share = len(drawn) / points
    return Survey(points, read - points, strays, keep_low, keep_high, low, high, known, share)


def left_out(found: Survey) -> Iterator[str]:
    """What is set aside and why, a line each."""
    if found.dropped:
        yield f"left out {found.dropped:,} points whose coordinates are not finite"
    if found.strays:
        size = " x ".join(f"{side:.4g}" for side in found.high - found.low)
        yield f"left out {found.strays:,} points far from all others (they reach {size} units)"


class Block(NamedTuple):
    """Points of a scene that float32 can hold, as they come."""

    xyz: F64
    """(N, 3) scene frame."""
    rgb: U8
    """(N, 3)"""
    read: int
    """How many there were with those that it cannot hold."""
    low: F64
    """(3,) least coordinates; infinite where there are none."""
    high: F64


def finite(source: SceneSource, chunk: int) -> Iterator[Block]:
    """The scene in blocks of at most ``chunk`` points."""
    for xyz, rgb in source.chunks(chunk):
        count, good, low, high = finite_rows(xyz)
        if count == len(xyz):
            yield Block(xyz, rgb, len(xyz), low, high)
        else:
            yield Block(xyz[good], rgb[good], len(xyz), low, high)


def within(xyz: F64, low: F64, high: F64) -> Mask:
    """Which of (N, 3) points lie in a closed box."""
    inside = np.ones(len(xyz), np.bool_)
    for axis in range(3):
        inside &= (xyz[:, axis] >= low[axis]) & (xyz[:, axis] <= high[axis])
    return inside


def kept_box(sample: F64) -> tuple[F64, F64]:
    """Corners of the box that is not astray: the body, and what follows it without a gap."""
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    for share, gap in ((GROUP_SHARE, FARTHEST), (TAIL_SHARE, GAP)):
        axes = np.sort(sample[within(sample, low, high)], axis=0)
        if len(axes) < FEWEST_FOR_TAILS:
            break
        tail = max(int(share * len(axes)), 1)
        body = axes[tail:-tail]
        side = float((body[-1] - body[0]).max())
        if not side:
            break
        if share == TAIL_SHARE:
            low = np.maximum(low, body[0] - FARTHEST * side)
            high = np.minimum(high, body[-1] + FARTHEST * side)
        for axis in range(3):
            column = axes[:, axis]
            above = np.flatnonzero(np.diff(column[-tail - 1 :]) > gap * side)
            if len(above):
                high[axis] = min(high[axis], column[-tail - 1 :][above[0]] + gap * side / 2)
            below = np.flatnonzero(np.diff(column[: tail + 1]) > gap * side)
            if len(below):
                low[axis] = max(low[axis], column[: tail + 1][below[-1] + 1] - gap * side / 2)
    return low, high


def _step(values: F64) -> float:
    """Largest step of which all differences of ascending values are multiples; 0 without one."""
    if len(values) < 3:
        return 0.0
    smallest = float(np.diff(values).min())
    for parts in (1, 2, 5, 10):  # the least difference seen may be a few steps
        multiples = (values - values[0]) / (smallest / parts)
        if multiples[-1] < 2**40 and np.abs(multiples - np.rint(multiples)).max() < 0.02:
            return smallest / parts
    return 0.0
