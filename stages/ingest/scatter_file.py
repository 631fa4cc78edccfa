"""A scratch file in which points are gathered by leaf without holding them in memory."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import I64
from spinpipe.stages.ingest.tiling import POINT, taken


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

    def append(self, points: NDArray[np.void], leaf: NDArray[np.unsignedinteger]) -> None:
        """Add points (N,) of dtype ``POINT`` that belong to the leaves (N,)."""
        order = np.argsort(leaf, kind="stable")  # a radix sort for 16 bits
        taken(points, order).tofile(self._file)
        counts = np.bincount(leaf, minlength=self._leaves)
        self._starts.append(self._written + np.append(0, np.cumsum(counts)))
        self._written += len(points)

    def read(self, leaf: int) -> NDArray[np.void]:
        """All points of a leaf, in the order of appending; several threads may ask."""
        parts: list[bytes] = []
        for starts in self._starts:
            begin, end = POINT.itemsize * int(starts[leaf]), POINT.itemsize * int(starts[leaf + 1])
            parts.append(os.pread(self._file.fileno(), end - begin, begin))
            if len(parts[-1]) < end - begin:
                raise OSError(errno.EIO, "points that were put aside cannot be read back")
        return np.frombuffer(b"".join(parts), POINT)

    def __enter__(self) -> ScatterFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()
