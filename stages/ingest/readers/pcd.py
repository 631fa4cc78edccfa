"""PCD clouds of the Point Cloud Library: ascii, binary and binary_compressed.

Format: [PCL documentation, The PCD (Point Cloud Data) file format, version 0.7]; compressed data
are LZF [Lehmann, liblzf], field after field.
"""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spinpipe.schemas.arrays import U8
from spinpipe.stages.ingest.readers.coordinates import Coordinates, beside
from spinpipe.stages.ingest.readers.data_kind import left_over, why_not
from spinpipe.stages.ingest.readers.point_fields import colours_of, xyz_of
from spinpipe.stages.ingest.readers.scene_source import About, Chunk
from spinpipe.stages.stage import StageError

_LONGEST_HEADER = 1 << 16
_ENCODINGS = ("ascii", "binary", "binary_compressed")
_SHOWN = ("x", "y", "z", "rgb", "rgba")
"""Fields that come out as coordinates and colours."""
_LARGEST_RATIO = 255
"""LZF writes at most 264 bytes for three of its own."""


class PcdSource:
    """The points of a PCD file.

    Raises
    ------
    StageError
        When the header is broken, x, y or z are missing, or the file is cut short.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as file:
            head = file.read(_LONGEST_HEADER)
        found = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", head, re.M)
        if found is None:
            raise self._broken("it has no line DATA")
        self._offset = found.end()
        self._encoding = found[1].decode()
        lines = head[: found.start()].decode("latin-1").splitlines()
        entries = {w[0]: w[1:] for w in (line.split() for line in lines) if w and w[0][0] != "#"}
        if self._encoding not in _ENCODINGS:
            raise self._broken(f"DATA is none of {', '.join(_ENCODINGS)}")
        try:
            self._dtype, self.points = _layout(entries)
        except (KeyError, ValueError, IndexError) as error:
            raise self._broken(f"{error}") from None
        names = self._dtype.names or ()
        missing = [axis for axis in "xyz" if axis not in names]
        if missing:
            raise StageError(
                f"{path}: its points have no field {', '.join(missing)} (only {', '.join(names)}); "
                "export the cloud with coordinates"
            )
        if self.points and (why := why_not(path, self._offset, self._encoding == "ascii")):
            raise StageError(f"{path}: {why}; export the cloud again")
        self.coloured = "rgb" in names or "rgba" in names
        row, size = self._dtype.itemsize, path.stat().st_size
        fits = self._encoding == "binary"
        end = self._offset + self.points * row
        self.about = About(
            kind=f"PCD, {self._encoding}",
            fields=tuple(n for n in names if n not in _SHOWN and n[0] != "_"),
            coordinates=beside(path) or Coordinates(),
            notes=left_over(size, end, row, self.points) if fits else (),
        )
        self._check_size()

    def chunks(self, points: int) -> Iterator[Chunk]:
        """Points in the file's order, at most ``points`` at a time."""
        rows = {
            "ascii": self._text_rows,
            "binary": self._binary_rows,
            "binary_compressed": self._compressed_rows,
        }[self._encoding]
        for block in rows(points):
            yield xyz_of(block), colours_of(block)

    def _binary_rows(self, points: int) -> Iterator[NDArray[Any]]:
        with self._path.open("rb") as file:
            file.seek(self._offset)
            for start in range(0, self.points, points):
                yield np.fromfile(file, self._dtype, min(points, self.points - start))

    def _compressed_rows(self, points: int) -> Iterator[NDArray[Any]]:
        with self._path.open("rb") as file:
            packed = self._packed_size(file)
            size = self.points * self._dtype.itemsize
            data = unpack_lzf(np.fromfile(file, np.uint8, packed), size)
        if data is None:
            raise StageError(f"{self._path}: its compressed data are damaged; export it again")
        fields = {}
        start = 0
        for name in self._dtype.names or ():
            kind = self._dtype[name]
            end = start + kind.itemsize * self.points
            fields[name] = data[start:end].view(kind.base).reshape(self.points, *kind.shape)
            start = end
        for begin in range(0, self.points, points):
            rows = np.empty(min(points, self.points - begin), self._dtype)
            for name, column in fields.items():
                rows[name] = column[begin : begin + len(rows)]
            yield rows

    def _text_rows(self, points: int) -> Iterator[NDArray[Any]]:
        wide = {n: int(np.prod(self._dtype[n].shape, dtype=int)) for n in self._dtype.names or ()}
        firsts = dict(zip(wide, itertools.accumulate(wide.values(), initial=0), strict=False))
        names = [n for n in ("x", "y", "z", "rgb", "rgba") if n in wide]
        with self._path.open("rb") as file:
            file.seek(self._offset)
            lines = (line for line in file if line.strip())
            for start in range(0, self.points, points):
                count = min(points, self.points - start)
                block = list(itertools.islice(lines, count))
                if len(block) < count:
                    raise self._cut_short(self.points - start - len(block))
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("error")
                        table = np.loadtxt(
                            block, comments=None, usecols=[firsts[n] for n in names], ndmin=2
                        )
                except (ValueError, UnicodeDecodeError, Warning) as error:
                    raise StageError(
                        f"{self._path}: cannot read points {start:,} to {start + count:,} of "
                        f"{self.points:,} ({error}); it may be cut short, copy or export it again"
                    ) from None
                rows = np.zeros(count, [(n, self._dtype[n]) for n in names])
                for column, name in enumerate(names):
                    rows[name] = table[:, column].astype(self._dtype[name])
                yield rows

    def _check_size(self) -> None:
        """Compare the file's size with what the header promises."""
        there = self._path.stat().st_size - self._offset
        if self._encoding == "binary":
            missing = self.points - there // self._dtype.itemsize
            if missing > 0:
                raise self._cut_short(missing)
        elif self._encoding == "binary_compressed" and self.points:
            with self._path.open("rb") as file:
                self._packed_size(file)
        elif self._encoding == "ascii" and there < 2 * self.points:
            raise self._cut_short(self.points - there // 6)

    def _packed_size(self, file: BinaryIO) -> int:
        """Bytes of the compressed data, behind which the file stands then."""
        file.seek(self._offset)
        sizes = np.fromfile(file, "<u4", 2)
        there = self._path.stat().st_size - file.tell()
        size = self.points * self._dtype.itemsize
        if len(sizes) < 2 or sizes[0] > there:
            raise StageError(f"{self._path}: cut short; copy or export the file again")
        if int(sizes[1]) != size or size > _LARGEST_RATIO * int(sizes[0]):
            raise self._broken(f"{sizes[1]:,} bytes of data do not make {self.points:,} points")
        return int(sizes[0])

    def _broken(self, what: str) -> StageError:
        return StageError(f"{self._path}: broken PCD header: {what}; export the file again")

    def _cut_short(self, missing: int) -> StageError:
        return StageError(
            f"{self._path}: cut short, {missing:,} of {self.points:,} points are missing; "
            "copy or export the file again"
        )


def _layout(entries: dict[str, list[str]]) -> tuple[np.dtype[Any], int]:
    """Type of a row and number of rows."""
    names = entries.get("FIELDS") or entries["COLUMNS"]
    counts = entries.get("COUNT", ["1"] * len(names))
    kinds: list[tuple[str, str, int]] = []
    for i, (name, size, letter, count) in enumerate(
        zip(names, entries["SIZE"], entries["TYPE"], counts, strict=True)
    ):
        code = {"F": "f", "I": "i", "U": "u"}[letter] + str(int(size))
        if code not in ("f4", "f8", *(s + n for s in "iu" for n in "1248")) or int(count) < 1:
            raise ValueError(f"no type {letter} of {size} bytes")
        padding = name == "_" or name in names[:i]  # '_' may come several times
        kinds.append((f"_{i}" if padding else name, "<" + code, int(count)))
    rows = [int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])] if "WIDTH" in entries else []
    points = int(entries["POINTS"][0]) if "POINTS" in entries else rows[0]
    if points < 0 or (rows and rows[0] != points):
        raise ValueError(f"POINTS is {points:,}, WIDTH times HEIGHT {rows[0]:,}")
    return np.dtype([(n, k) if c == 1 else (n, k, c) for n, k, c in kinds]), points


def unpack_lzf(packed: U8, size: int) -> U8 | None:
    """``size`` bytes from LZF data; None where they are damaged."""
    data = np.empty(size, np.uint8)
    return data if _unpack_lzf(packed, data) else None


@njit(cache=True, nogil=True)
def _unpack_lzf(packed: U8, data: U8) -> bool:
    read = write = 0
    while read < len(packed):
        control = np.int64(packed[read])
        read += 1
        if control < 32:  # control + 1 bytes as they are
            length = control + 1
            if read + length > len(packed) or write + length > len(data):
                return False
            data[write : write + length] = packed[read : read + length]
            read += length
        else:  # bytes that came before
            length = control >> 5
            if length == 7:
                if read >= len(packed):
                    return False
                length += np.int64(packed[read])
                read += 1
            length += 2
            if read >= len(packed):
                return False
            back = write - ((control & 31) << 8) - np.int64(packed[read]) - 1
            read += 1
            if back < 0 or write + length > len(data):
                return False
            for i in range(length):  # may overlap with itself
                data[write + i] = data[back + i]
        write += length
    return write == len(data)
