"""PLY clouds: ascii and binary of both byte orders, any number types, extra properties ignored."""

from __future__ import annotations

import itertools
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.ingest.readers.coordinates import Coordinates, beside, from_text
from spinpipe.stages.ingest.readers.data_kind import left_over, why_not
from spinpipe.stages.ingest.readers.ply_header import PlyElement, PlyHeader, parse_header
from spinpipe.stages.ingest.readers.ply_lists import ListRows
from spinpipe.stages.ingest.readers.point_fields import full_colour, to_8_bit
from spinpipe.stages.ingest.readers.scene_source import About, Chunk, white
from spinpipe.stages.stage import StageError

_COLOURS = tuple(
    tuple(prefix + name for name in names)
    for prefix in ("", "diffuse_")
    for names in (("red", "green", "blue"), ("r", "g", "b"))
)
_LONGEST_HEADER = 1 << 20
_SKIPPED_ROWS = 1 << 18


def read_header(path: Path) -> PlyHeader:
    """Parse the header only.

    Raises
    ------
    StageError
        When the file is no PLY file or its header is broken.
    """
    with path.open("rb") as file:
        head = file.read(_LONGEST_HEADER)
    try:
        return parse_header(head)
    except ValueError as error:
        raise StageError(f"{path}: {error}; export the file again") from None


class PlySource:
    """The vertices of a PLY file.

    Raises
    ------
    StageError
        When the header is broken, x, y or z are missing, or the file is cut short.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._header = read_header(path)
        names = [element.name.lower() for element in self._header.elements]
        if "vertex" not in names:
            raise StageError(f"{path}: the PLY file has no element 'vertex'; give a point cloud")
        self._index = names.index("vertex")
        self._vertex = self._header.elements[self._index]
        self.points = self._vertex.count
        # PDAL writes names in capitals
        fields = {prop.name.lower(): prop.name for prop in reversed(self._vertex.properties)}
        missing = [axis for axis in "xyz" if axis not in fields]
        if missing:
            raise StageError(
                f"{path}: its vertices have no property {', '.join(missing)} (only "
                f"{', '.join(reversed(fields.values()))}); export the cloud with coordinates"
            )
        colours = next((c for c in _COLOURS if set(c) <= set(fields)), ())
        self._axes = tuple(fields[axis] for axis in "xyz")
        self._colours = tuple(fields[name] for name in colours)
        self._full: float | None = None
        if self.points and (why := why_not(path, self._header.data_offset, self._header.text)):
            raise StageError(f"{path}: {why}; export the cloud again")
        number = np.dtype(self._vertex.properties[self._column(self._axes[0])].dtype).name
        self.about = About(
            kind=f"PLY, {self._header.encoding}, {number}",
            fields=tuple(
                prop.name
                for prop in self._vertex.properties
                if prop.name not in (*self._axes, *self._colours)
            ),
            coordinates=beside(path)
            or from_text(self._header.comments, "a comment in the PLY header")
            or Coordinates(),
            notes=self._left_over(),
        )
        if not self._header.text and not self._has_lists():
            self._check_size()

    @property
    def coloured(self) -> bool:
        """Whether the vertices have red, green and blue."""
        return bool(self._colours)

    def chunks(self, points: int) -> Iterator[Chunk]:
        """Vertices in the file's order, at most ``points`` at a time."""
        if self._colours and self._full is None:
            self._full = full_colour(_matrix(rows, self._colours) for rows in self._rows(points))
        for rows in self._rows(points):
            xyz = _matrix(rows, self._axes, np.float64)
            if self._full is None:
                yield xyz, white(len(rows))
            else:
                yield xyz, to_8_bit(_matrix(rows, self._colours), self._full)

    def _rows(self, points: int) -> Iterator[NDArray[Any]]:
        """Structured rows that have at least x, y, z and the colours."""
        if self._header.text:
            return self._text_rows(points)
        if self._has_lists():
            return self._list_rows(points)
        return self._binary_rows(points)

    def _has_lists(self) -> bool:
        """Whether a row's place in the file depends on the length of lists before it."""
        return any(e.count and e.has_lists for e in self._header.elements[: self._index + 1])

    def _check_size(self) -> None:
        """Compare the file's size with what the header promises."""
        row = self._vertex.dtype.itemsize
        missing = self._vertex_offset() + self.points * row - self._path.stat().st_size
        if missing > 0:
            raise StageError(
                f"{self._path}: cut short, {missing:,} bytes or {-(-missing // row):,} of "
                f"{self.points:,} points are missing; copy or export the file again"
            )

    def _left_over(self) -> tuple[str, ...]:
        tables = self._header.elements
        if self._header.text or any(e.count and e.has_lists for e in tables):
            return ()
        end = self._header.data_offset + sum(e.count * e.dtype.itemsize for e in tables if e.count)
        row = self._vertex.dtype.itemsize
        return left_over(self._path.stat().st_size, end, row, self.points)

    def _vertex_offset(self) -> int:
        before = self._header.elements[: self._index]
        return self._header.data_offset + sum(e.count * e.dtype.itemsize for e in before if e.count)

    def _binary_rows(self, points: int) -> Iterator[NDArray[Any]]:
        dtype = self._vertex.dtype
        # Read, not memory-mapped: mapped pages would count as the process's memory
        with self._path.open("rb") as file:
            file.seek(self._vertex_offset())
            for start in range(0, self.points, points):
                rows = np.fromfile(file, dtype, min(points, self.points - start))
                if len(rows) < min(points, self.points - start):
                    raise self._cut_short(start + len(rows))
                yield rows

    def _column(self, name: str) -> int:
        return next(i for i, prop in enumerate(self._vertex.properties) if prop.name == name)

    def _text_rows(self, points: int) -> Iterator[NDArray[Any]]:
        wanted = (*self._axes, *self._colours)
        columns = [self._column(name) for name in wanted]
        types = [self._vertex.properties[column].dtype for column in columns]
        # Text of a whole number may carry a decimal point or an exponent: read all as float64
        parsed = np.dtype([(name, np.float64) for name in wanted])
        exact = np.dtype(list(zip(wanted, types, strict=True)))
        leading = self._vertex.properties[: max(columns)]
        lists = any(prop.count_dtype is not None for prop in leading)
        with self._path.open("rb") as file:
            file.seek(self._header.data_offset)
            rows_before = sum(e.count for e in self._header.elements[: self._index])
            lines = (line for line in file if line.strip())
            for start in range(0, self.points, points):
                skip = rows_before if start == 0 else 0
                count = min(points, self.points - start)
                block = list(itertools.islice(lines, skip, skip + count))
                # The format knows no commas: one can only be a decimal comma
                block = [line.replace(b",", b".") if b"," in line else line for line in block]
                if lists:
                    block = [self._without_lists(line) for line in block]
                    columns = list(range(len(wanted)))
                rows = self._parse(block, columns, parsed, start)
                if len(rows) < count:
                    raise self._cut_short(start + len(rows))
                yield rows.astype(exact)

    def _without_lists(self, line: bytes) -> bytes:
        """The coordinates and colours of a row whose columns lists move."""
        words = line.split()
        values: dict[str, bytes] = {}
        at = 0
        for prop in self._vertex.properties:
            if prop.count_dtype is None:
                values[prop.name] = words[at] if at < len(words) else b"?"
            elif at < len(words):
                at += int(words[at]) if words[at].isdigit() else len(words)
            at += 1
        return b" ".join(values[name] for name in (*self._axes, *self._colours))

    def _parse(
        self, lines: list[bytes], columns: list[int], dtype: np.dtype[Any], start: int
    ) -> NDArray[Any]:
        if not lines:
            return np.empty(0, dtype)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                return np.loadtxt(lines, dtype, comments=None, usecols=columns, ndmin=1)
        except (ValueError, UnicodeDecodeError, Warning) as error:
            raise StageError(
                f"{self._path}: cannot read points {start:,} to {start + len(lines):,} of "
                f"{self.points:,} ({error}); the file may be cut short, copy or export it again"
            ) from error

    def _list_rows(self, points: int) -> Iterator[NDArray[Any]]:
        """Rows behind or among lists of any length."""
        names = (*self._axes, *self._colours)
        wanted = ListRows(_layout(self._vertex), [self._column(n) for n in names], names)
        found = 0
        with self._path.open("rb") as file:
            file.seek(self._header.data_offset)
            for element in self._header.elements[: self._index]:
                skip_rows(file, element)
            for rows in wanted.read(file, self.points, points):
                found += len(rows)
                yield rows
        if found < self.points:
            raise self._cut_short(found)

    def _cut_short(self, found: int) -> StageError:
        return StageError(
            f"{self._path}: cut short, {self.points - found:,} of {self.points:,} points are "
            "missing; copy or export the file again"
        )


def skip_rows(file: BinaryIO, element: PlyElement) -> None:
    """Go behind the binary rows of an element."""
    if not element.has_lists:
        file.seek(element.count * element.dtype.itemsize if element.count else 0, os.SEEK_CUR)
        return
    for _ in ListRows(_layout(element)).read(file, element.count, _SKIPPED_ROWS):
        pass


def _layout(element: PlyElement) -> list[tuple[np.dtype[Any] | None, np.dtype[Any]]]:
    """Types of an element's properties, with those of list lengths."""
    return [(prop.count_dtype, prop.dtype) for prop in element.properties]


def _matrix(
    rows: NDArray[Any], names: tuple[str, ...], dtype: type[np.float64] | None = None
) -> NDArray[Any]:
    """Columns of structured rows as (N, len(names)), in native byte order."""
    common = dtype or np.result_type(*(rows.dtype[name] for name in names))
    matrix = np.empty((len(rows), len(names)), common)
    for column, name in enumerate(names):
        matrix[:, column] = rows[name]
    return matrix
