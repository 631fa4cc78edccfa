"""A scratch file in which points are gathered by leaf without holding them in memory."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import I64
from spinpipe.stages.ingest.tiling import POINT


class ScatterFile:
    """Blocks of points, each sorted by leaf, one behind the other; a leaf is read from all blocks.

    Parameters
    ----------
    folder : Path
        On the disk that has room for it. The file has no name: whatever ends the process, nothing
        stays behind.
    leaves : int
    """

    def __init__(self, folder: Path, leaves: int) -> None:
        self._file = TemporaryFile("w+b", dir=folder)  # noqa: SIM115  closed by __exit__
        self._leaves = leaves
        self._starts: list[I64] = []
        self._written = 0

    def append(self, points: NDArray[np.void], leaf: I64) -> None:
        """Add points (N,) of dtype ``POINT`` that belong to the leaves (N,)."""
        small = leaf.astype(np.uint16) if self._leaves <= 1 << 16 else leaf
        order = np.argsort(small, kind="stable")  # a radix sort for 16 bits
        points[order].tofile(self._file)
        counts = np.bincount(leaf, minlength=self._leaves)
        self._starts.append(self._written + np.append(0, np.cumsum(counts)))
        self._written += len(points)

    def read(self, leaf: int) -> NDArray[np.void]:
        """All points of a leaf, in the order of appending."""
        extents = [(starts[leaf], starts[leaf + 1] - starts[leaf]) for starts in self._starts]
        points = np.empty(sum(int(count) for _, count in extents), POINT)
        filled = 0
        for start, count in extents:
            if count:
                self._file.seek(int(start) * POINT.itemsize)
                points[filled : filled + count] = np.fromfile(self._file, POINT, int(count))
                filled += int(count)
        return points

    def __enter__(self) -> ScatterFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
