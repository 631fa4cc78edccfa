"""Spin images and correlations at many origins, by compiled kernels on several threads.

Counts are integers and equal those of the numpy twin ``spin_image``; nothing depends on the order
of points or origins, on the number of threads or on how origins are grouped. With a least
correlation the scan also proves for whole groups of origins that none of them is a hit
(``pruning``) and gives the very hits of the exhaustive scan for less work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F32, I64, U32
from spinpipe.stages.scan.classes import make_test_scratch
from spinpipe.stages.scan.count import make_scratch
from spinpipe.stages.scan.image import SpinGrid
from spinpipe.stages.scan.index import SpinIndex, build_index, side_for, sort_by_cell
from spinpipe.stages.scan.kernel import count_blocks, prune_blocks, scan_blocks
from spinpipe.stages.scan.templates import Templates
from spinpipe.stages.threads import map_threads

__all__ = ["BELOW", "ScanWork", "SpinIndex", "build_index", "correlate", "histograms"]

BELOW = np.float32(-1)
"""Stands for every correlation below the least one asked for."""

CHUNK_ORIGINS = 8192
"""Origins handed to a thread at once."""

SHARING_ORIGINS = 64
"""Origins of a block among which the cost of gathering is small."""


@dataclass
class ScanWork:
    """What scans cost, added up."""

    origins: int = 0
    visits: int = 0
    """Points binned, for origins and for tests of groups."""
    tests: int = 0
    """Groups of origins tested."""
    scanned: int = 0
    """Origins whose spin image was made."""


def histograms(index: SpinIndex, origins: NDArray[Any], grid: SpinGrid) -> U32:
    """Spin images at many origins, identical to ``spin_image`` at each.

    Parameters
    ----------
    index : SpinIndex
    origins : (M, 3) array
        In the index's frame, metres; taken as float32.
    grid : SpinGrid

    Returns
    -------
    (M, rows, cols) uint32 array
    """
    blocks = OriginBlocks.of(origins, grid.radius_m / 5, 256)
    counted = np.zeros((len(blocks.order), grid.k), np.uint32)
    count_blocks(index, blocks.origins, blocks.start, grid, make_scratch(grid.k), counted)
    images = np.empty_like(counted)
    images[blocks.order] = counted
    return images.reshape(-1, *grid.shape)


def correlate(
    index: SpinIndex,
    origins: NDArray[Any],
    templates: Templates,
    threads: int = 1,
    *,
    min_correlation: float | None = None,
    advance: Callable[[int], None] | None = None,
    work: ScanWork | None = None,
) -> F32:
    """Correlation of the spin image at every origin with every template, in one pass.

    Parameters
    ----------
    index : SpinIndex
    origins : (M, 3) array
        In the index's frame, metres; taken as float32.
    templates : Templates
    threads : int
        Threads to use; the result is the same for any number.
    min_correlation : float, optional
        Find only correlations of at least this (positive, compared as float32): the others are
        given as ``BELOW``, and whole groups of origins are skipped where they provably are. The
        exhaustive scan if not given.
    advance : callable, optional
        Told, in the calling thread, how many more origins are done.
    work : ScanWork, optional
        Counters to add to.

    Returns
    -------
    (T, M) float32 array

    Raises
    ------
    ValueError
        An origin is not finite, or the least correlation is not positive.
    """
    if min_correlation is not None and not min_correlation > 0:
        raise ValueError(f"correlate: min_correlation is {min_correlation}; it must be positive")
    grid = templates.grid
    if min_correlation is None:
        blocks = OriginBlocks.of(origins, grid.radius_m / 5, 256, widest_m=grid.radius_m / 2.5)
    else:
        blocks = OriginBlocks.of(origins, grid.radius_m / 3.5, 4096)
    found = np.full((templates.size, len(blocks.order)), BELOW)

    def scan(chunk: tuple[int, int]) -> tuple[int, I64]:
        first, last = chunk
        start = blocks.start
        cost = np.zeros(3, np.int64)
        given = (index, blocks.origins, start[first : last + 1], templates)
        scratch = make_scratch(grid.k)
        if min_correlation is None:
            scan_blocks(*given, scratch, found, cost)
        else:
            tests, least = make_test_scratch(*grid.shape), np.float32(min_correlation)
            prune_blocks(*given, least, scratch, tests, found, cost)
        return int(start[last] - start[first]), cost

    for count, (visits, tests, scanned) in map_threads(scan, blocks.chunks(), threads):
        if work is not None:
            work.origins += count
            work.visits += int(visits)
            work.tests += int(tests)
            work.scanned += int(scanned)
        if advance is not None:
            advance(count)
    correlations = np.empty_like(found)
    correlations[:, blocks.order] = found
    return correlations


@dataclass(frozen=True, eq=False)
class OriginBlocks:
    """Origins grouped into blocks of neighbours, so that kernels read and write in one sweep.

    Attributes
    ----------
    origins : (M, 3) float32 array
        By block.
    order : (M,) int64 array
        Where each was among those given.
    start : (B + 1,) int64 array
        First of each block.
    """

    origins: F32
    order: I64
    start: I64

    @classmethod
    def of(
        cls, origins: NDArray[Any], side_m: float, most: int, widest_m: float = 0.0
    ) -> OriginBlocks:
        """Group origins by squares of ``side_m``, at most ``most`` of like height together.

        Where origins are sparse the squares grow up to ``widest_m``, so that enough of them share
        what is gathered for them.
        """
        points = np.ascontiguousarray(np.asarray(origins, dtype=np.float32).reshape(-1, 3))
        if not np.isfinite(points).all():
            raise ValueError("scan: origins hold NaN or infinite coordinates; drop them")
        if len(points) == 0:
            return cls(points, np.zeros(0, np.int64), np.zeros(1, np.int64))
        side_m = max(side_m, min(side_for(points, SHARING_ORIGINS), widest_m))
        order, square, *_ = sort_by_cell(points, side_m)
        fresh = np.r_[True, square[1:] != square[:-1]]
        first = np.flatnonzero(fresh)
        rank = np.arange(len(points)) - np.repeat(first, np.diff(first, append=len(points)))
        start = np.r_[np.flatnonzero(rank % most == 0), len(points)]
        return cls(points[order], order, start)

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.start) - 1

    def chunks(self) -> Iterator[tuple[int, int]]:
        """Ranges of blocks with about ``CHUNK_ORIGINS`` origins each."""
        first = 0
        while first < self.count:
            last = int(np.searchsorted(self.start, self.start[first] + CHUNK_ORIGINS))
            last = min(max(last, first + 1), self.count)
            yield first, last
            first = last
