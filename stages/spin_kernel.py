"""Compiled spin scan: histograms and correlations at many origins.

Origins are taken in blocks of neighbours. A block collects the runs of points that any of its
origins can reach; each origin then bins them in two loops, first the bin numbers of a run (which
LLVM vectorises), then the counting. Counts are integers and equal those of the numpy twin
``spin_image``; nothing depends on the order of points or origins or on the number of threads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spinpipe.stages.spin_count import (
    BUFFER,
    COPIES,
    LANES,
    collect_runs,
    count_origin,
)
from spinpipe.stages.spin_image import FLAT_VARIANCE, SpinGrid, SpinTemplate
from spinpipe.stages.spin_index import SpinIndex, build_index

__all__ = ["ScanWork", "SpinIndex", "build_index", "correlate", "histograms"]

BLOCK_M = 0.5
"""Origins of one block lie in a square of this side."""
BLOCK_ORIGINS = 256
CHUNK_ORIGINS = 4096
"""Origins handed to a thread at once."""

T = TypeVar("T")
R = TypeVar("R")


@dataclass
class ScanWork:
    """What scans cost, added up."""

    origins: int = 0
    visits: int = 0
    """Points whose bin was computed."""


def histograms(index: SpinIndex, origins: NDArray[Any], grid: SpinGrid) -> NDArray[np.uint32]:
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
    blocks = OriginBlocks.of(origins)
    images = np.zeros((len(blocks.order), grid.k), np.uint32)
    tables = scan_tables([], [grid])
    unused = np.zeros((0, len(blocks.order)), np.float32)
    _scan_blocks(*index_arrays(index), *blocks.arrays, 0, blocks.count, *tables, unused, images)
    return images.reshape(-1, *grid.shape)


def correlate(
    index: SpinIndex,
    origins: NDArray[Any],
    templates: Sequence[SpinTemplate],
    threads: int = 1,
    *,
    advance: Callable[[int], None] | None = None,
    work: ScanWork | None = None,
) -> NDArray[np.float32]:
    """Correlation of the spin image at every origin with every template, in one pass.

    Templates may differ in grid, values and weights; those of one grid share its histogram.

    Parameters
    ----------
    index : SpinIndex
    origins : (M, 3) array
        In the index's frame, metres; taken as float32.
    templates : sequence of SpinTemplate
    threads : int
        Threads to use; the result is the same for any number.
    advance : callable, optional
        Told, in the calling thread, how many more origins are done.
    work : ScanWork, optional
        Counters to add to.

    Returns
    -------
    (len(templates), M) float32 array

    Raises
    ------
    ValueError
        An origin is not finite.
    """
    blocks = OriginBlocks.of(origins)
    tables = scan_tables(templates, list(dict.fromkeys(t.grid for t in templates)))
    found = np.zeros((len(templates), len(blocks.order)), np.float32)
    if not templates:
        return found
    no_images = np.zeros((0, 0), np.uint32)

    def scan(chunk: tuple[int, int]) -> tuple[int, int]:
        visits = _scan_blocks(
            *index_arrays(index), *blocks.arrays, *chunk, *tables, found, no_images
        )
        return int(blocks.start[chunk[1]] - blocks.start[chunk[0]]), int(visits)

    for count, visits in map_threads(scan, blocks.chunks(), threads):
        if work is not None:
            work.origins += count
            work.visits += visits
        if advance is not None:
            advance(count)
    return found


@dataclass(frozen=True, eq=False)
class OriginBlocks:
    """Origins grouped into blocks of neighbours.

    Attributes
    ----------
    origins : (M, 3) float32 array
        In the caller's order.
    order : (M,) int64 array
        Origins by block.
    start : (B + 1,) int64 array
        First of each block in ``order``.
    """

    origins: NDArray[np.float32]
    order: NDArray[np.int64]
    start: NDArray[np.int64]

    @classmethod
    def of(cls, origins: NDArray[Any]) -> OriginBlocks:
        """Group origins by squares of ``BLOCK_M``, at most ``BLOCK_ORIGINS`` together."""
        points = np.ascontiguousarray(np.asarray(origins, dtype=np.float32).reshape(-1, 3))
        if not np.isfinite(points).all():
            raise ValueError("scan: origins hold NaN or infinite coordinates; drop them")
        squares = np.floor(points[:, :2].astype(np.float64) / BLOCK_M)
        order = np.lexsort((points[:, 2], squares[:, 1], squares[:, 0]))
        ordered = squares[order]
        fresh = np.ones(len(points), bool)
        fresh[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
        first = np.flatnonzero(fresh)
        rank = np.arange(len(points)) - np.repeat(first, np.diff(np.r_[first, len(points)]))
        start = np.r_[np.flatnonzero(rank % BLOCK_ORIGINS == 0), len(points)]
        return cls(points, order, start)

    @property
    def count(self) -> int:
        """Number of blocks."""
        return len(self.start) - 1

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Origins, order and starts for the kernels."""
        return self.origins, self.order, self.start

    def chunks(self) -> Iterator[tuple[int, int]]:
        """Ranges of blocks with about ``CHUNK_ORIGINS`` origins each."""
        first = 0
        while first < self.count:
            last = int(np.searchsorted(self.start, self.start[first] + CHUNK_ORIGINS))
            last = min(max(last, first + 1), self.count)
            yield first, last
            first = last


def map_threads(function: Callable[[T], R], items: Iterable[T], threads: int) -> Iterator[R]:
    """Yield ``function`` of every item, in order, by threads; few items wait at a time."""
    if threads <= 1:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque[Future[R]] = deque()
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) > 4 * threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def index_arrays(index: SpinIndex) -> tuple[Any, ...]:
    """Return what the kernels take of an index."""
    return (
        index.xyz, index.start, index.key, index.bounds, index.corner, index.cells, index.cell_m,
    )  # fmt: skip


def scan_tables(
    templates: Sequence[SpinTemplate], grids: Sequence[SpinGrid]
) -> tuple[NDArray[Any], ...]:
    """Grids and templates as arrays.

    Returns
    -------
    tuple
        Grids' float32 numbers (G, 3) (radius_sq, height, bins_per_m) and sizes (G, 2) (cols, k);
        each template's grid (T,); weights, and weights times unit values, (T, widest k) float64,
        zero beyond a template's own k.
    """
    numbers = np.array([[g.radius_sq, g.height, g.bins_per_m] for g in grids], np.float32)
    sizes = np.array([[g.cols, g.k] for g in grids], np.int64)
    widest = -(-max((g.k for g in grids), default=0) // LANES) * LANES
    weights = np.zeros((len(templates), widest))
    values = np.zeros((len(templates), widest))
    for row, template in enumerate(templates):
        w = template.unit_weights()
        weights[row, : len(w)] = w
        values[row, : len(w)] = w * template.unit_values()
    grid_of = np.array([grids.index(t.grid) for t in templates], np.int64)
    return numbers.reshape(-1, 3), sizes.reshape(-1, 2), grid_of, weights, values


@njit(cache=True, nogil=True)
def _correlation(image, weights, values):
    """Pearson correlation of counts with a template of unit variance, summed in fixed lanes."""
    mean = np.zeros(8)
    square = np.zeros(8)
    product = np.zeros(8)
    for i in range(0, len(weights), 8):
        for lane in range(8):
            c = np.float64(image[i + lane])
            wc = weights[i + lane] * c
            mean[lane] += wc
            square[lane] += wc * c
            product[lane] += values[i + lane] * c
    m, s, p = mean.sum(), square.sum(), product.sum()
    variance = s - m * m
    if variance <= FLAT_VARIANCE * s:
        return np.float32(0)
    return np.float32(min(max(p / np.sqrt(variance), -1.0), 1.0))


@njit(cache=True, nogil=True)
def _scan_blocks(
    xyz, start, key, bounds, corner, cells, cell_m,
    origins, order, block_start, first_block, last_block,
    grid_numbers, grid_sizes, grid_of, weights, values, found, images,
):  # fmt: skip
    """Scan blocks of origins: correlations into ``found``, counts into ``images`` if it has rows.

    Returns the number of points visited.
    """
    radius = np.sqrt(grid_numbers[:, 0].max())
    height = grid_numbers[:, 1].max()
    widest = max(grid_sizes[:, 1].max(), weights.shape[1])
    side = np.int64((2 * radius + BLOCK_M) / cell_m) + 4
    cap = min(len(key), side * side)
    runs = np.empty((2, cap), np.int64)
    limits = np.empty((6, cap), np.float32)
    near = np.empty(cap, np.float32)
    numbers = np.empty(BUFFER + LANES, np.uint16)
    counts = np.empty((COPIES, widest + LANES), np.uint32)
    image = np.zeros(widest, np.uint32)
    box = np.empty(6, np.float32)
    visits = 0
    for block in range(first_block, last_block):
        members = order[block_start[block] : block_start[block + 1]]
        for axis in range(3):
            box[2 * axis] = origins[members, axis].min()
            box[2 * axis + 1] = origins[members, axis].max()
        reached = collect_runs(
            xyz, start, key, bounds, corner, cells, cell_m, box, radius, height, runs, limits
        )
        for o in members:
            for g in range(len(grid_sizes)):
                cols, bins = grid_sizes[g]
                image[bins:] = 0
                visits += count_origin(
                    xyz, runs, limits, reached, near,
                    origins[o, 0], origins[o, 1], origins[o, 2],
                    grid_numbers[g, 0], grid_numbers[g, 1], grid_numbers[g, 2],
                    np.int32(cols), np.int32(bins), numbers, counts, image,
                )  # fmt: skip
                for t in range(len(grid_of)):
                    if grid_of[t] == g:
                        found[t, o] = _correlation(image, weights[t], values[t])
                if len(images) > 0:
                    images[o] = image[:bins]
    return visits
