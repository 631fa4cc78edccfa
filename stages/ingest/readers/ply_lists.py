"""Binary PLY rows whose length varies because they hold lists, as OpenMVS writes them.

OpenMVS gives each vertex the list of the photos that see it; meshes may list faces before the
vertices. Such rows must be walked one by one to find where the next begins.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, BinaryIO, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spinpipe.schemas.arrays import I64, U8

_BLOCK = 1 << 22
"""Bytes read at once; no single row may be longer than this."""


class ListRows:
    """Walks the rows of one element of a binary PLY file.

    Parameters
    ----------
    properties : sequence of (count dtype or None, item dtype)
        The element's properties in order, dtypes in the file's byte order; a scalar has no count.
    wanted : sequence of int
        Scalars to keep, as indices of ``properties``.
    names : sequence of str
        Field names for them.
    """

    def __init__(
        self,
        properties: Sequence[tuple[np.dtype[Any] | None, np.dtype[Any]]],
        wanted: Sequence[int] = (),
        names: Sequence[str] = (),
    ) -> None:
        self.dtype = np.dtype([(n, properties[i][1]) for n, i in zip(names, wanted, strict=True)])
        self._sizes = np.array(
            [(count.itemsize if count else 0, item.itemsize) for count, item in properties]
        ).reshape(-1, 2)
        self._targets = np.full(len(properties), -1)
        fields = cast("Mapping[str, Any]", self.dtype.fields or {})
        for name, i in zip(names, wanted, strict=True):
            self._targets[i] = fields[name][1]
        self._big_endian = any(
            kind is not None and kind.str.startswith(">") for pair in properties for kind in pair
        )

    def read(self, file: BinaryIO, rows: int, most: int) -> Iterator[NDArray[Any]]:
        """Structured rows, at most ``most`` at a time; fewer than ``rows`` if the file ends early.

        The file's position begins at the first row and ends behind the last.
        """
        position = file.tell()
        while rows:
            file.seek(position)
            block = np.frombuffer(file.read(_BLOCK), np.uint8)
            packed = np.empty((min(rows, most), self.dtype.itemsize), np.uint8)
            done, used = _walk(block, self._sizes, self._targets, self._big_endian, packed)
            if not done:
                return
            rows -= done
            position += used
            file.seek(position)
            yield packed[:done].reshape(-1).view(self.dtype) if self.dtype.names else packed[:done]


@njit(cache=True, nogil=True)
def _walk(
    block: U8,
    sizes: I64,
    targets: I64,
    big_endian: bool,
    packed: U8,
) -> tuple[int, int]:
    """Copy the wanted scalars of each complete row; return how many rows and bytes that were."""
    end = used = 0
    for row in range(len(packed)):
        for column in range(len(sizes)):
            count_size, size = sizes[column]
            items = 1
            if count_size:
                if end + count_size > len(block):
                    return row, used
                items = 0
                for byte in range(count_size):
                    shift = 8 * (count_size - 1 - byte if big_endian else byte)
                    items |= np.int64(block[end + byte]) << shift
                end += count_size
            if items < 0 or items > (len(block) - end) // size:  # a product might overflow
                return row, used
            target = targets[column]
            if target >= 0:
                for byte in range(size):
                    packed[row, target + byte] = block[end + byte]
            end += items * size
        used = end
    return len(packed), used
