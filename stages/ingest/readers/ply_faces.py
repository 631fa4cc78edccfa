"""The faces of a PLY mesh: polygons or triangle strips, text or binary."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numba import njit

from spinpipe.schemas.arrays import F64, I64, U8
from spinpipe.stages.ingest.readers.ply import PlySource, read_header, skip_rows
from spinpipe.stages.ingest.readers.ply_header import PlyElement, PlyHeader
from spinpipe.stages.stage import StageError

_TABLES = ("face", "tristrips")
_INDICES = ("vertex_indices", "vertex_index")
_CHUNK = 1 << 18


def face_table(header: PlyHeader) -> PlyElement | None:
    """The element that holds faces or strips; None for a cloud."""
    return next((e for e in header.elements if e.name.lower() in _TABLES and e.count), None)


def read_ply_mesh(path: Path) -> tuple[F64, I64, U8 | None] | None:
    """Vertices (V, 3), triangles (F, 3) and colours (V, 3) or None; None for a cloud.

    Polygons are cut into fans; the strips of Stanford's scans are unwound, -1 begins another.

    Raises
    ------
    StageError
        When the file is broken or cut short.
    """
    header = read_header(path)
    table = face_table(header)
    if table is None:
        return None
    column = next(
        (i for i, p in enumerate(table.properties) if p.count_dtype and p.name.lower() in _INDICES),
        None,
    )
    if column is None:
        raise StageError(f"{path}: its faces have no list 'vertex_indices'; export it again")
    source = PlySource(path)
    pieces = list(source.chunks(_CHUNK))
    vertices = np.concatenate([np.empty((0, 3)), *(xyz for xyz, _ in pieces)])
    rgb = np.concatenate([np.empty((0, 3), np.uint8), *(rgb for _, rgb in pieces)])
    counts, items = _lists(path, header, table, column)
    faces = _strips(counts, items) if table.name.lower() == "tristrips" else _fans(counts, items)
    return vertices, faces, rgb if source.coloured else None


def _lists(path: Path, header: PlyHeader, table: PlyElement, column: int) -> tuple[I64, I64]:
    """Lengths of the lists in one column, and their items one after the other."""
    before = header.elements[: header.elements.index(table)]
    with path.open("rb") as file:
        file.seek(header.data_offset)
        if header.text:
            lines = (line for line in file if line.strip())
            skip = sum(element.count for element in before)
            rows = itertools.islice(lines, skip, skip + table.count)
            counts, items = _text_lists(path, rows, table, column)
        else:
            for element in before:
                skip_rows(file, element)
            data = np.fromfile(file, np.uint8)
            sizes = np.array(
                [(p.count_dtype.itemsize if p.count_dtype else 0, p.dtype.itemsize)
                 for p in table.properties]
            )  # fmt: skip
            kind = table.properties[column].dtype
            swapped, signed = kind.str.startswith(">"), kind.kind == "i"
            # A row holds at least its counts: no more rows than that fit, whatever is claimed
            counts = np.zeros(min(table.count, len(data)), np.int64)
            rows, total = _walk(data, sizes, column, swapped, signed, counts, np.empty(0, np.int64))
            counts, items = counts[:rows], np.empty(total, np.int64)
            _walk(data, sizes, column, swapped, signed, counts, items)
    if len(counts) < table.count:
        raise StageError(
            f"{path}: cut short, {table.count - len(counts):,} of {table.count:,} faces are "
            "missing; copy or export the file again"
        )
    return counts, items


def _text_lists(
    path: Path, rows: Iterable[bytes], table: PlyElement, column: int
) -> tuple[I64, I64]:
    counts: list[int] = []
    items: list[int] = []
    try:
        for row in rows:
            words = row.split()
            at = 0
            for prop in table.properties[:column]:
                at += 1 + (int(words[at]) if prop.count_dtype else 0)
            counts.append(int(words[at]))
            listed = words[at + 1 : at + 1 + counts[-1]]
            if len(listed) < counts[-1]:
                raise IndexError
            items.extend(map(int, listed))
    except (ValueError, IndexError):
        raise StageError(
            f"{path}: face {len(counts):,} of {table.count:,} is damaged; it may be cut short, "
            "copy or export the file again"
        ) from None
    return np.array(counts, np.int64), np.array(items, np.int64)


def _fans(counts: I64, items: I64) -> I64:
    """Triangles of polygons: corner 0 with each further edge."""
    starts = np.cumsum(counts) - counts
    triangles = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), triangles)
    nth = np.arange(len(polygon)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    first = starts[polygon]
    return np.stack([items[first], items[first + nth + 1], items[first + nth + 2]], axis=1)


def _strips(counts: I64, items: I64) -> I64:
    """Triangles of strips: any three neighbours, every other one wound the other way."""
    ends = np.cumsum(counts)
    last = np.zeros(len(items), np.bool_)  # a strip must not go on into the next list
    last[ends[ends > 0] - 1] = True
    new = np.concatenate([[True], last[:-1] | (items[:-1] < 0)])[: len(items)]
    place = np.arange(len(items))
    nth = place - np.maximum.accumulate(np.where(new, place, 0))
    third = np.flatnonzero((nth >= 2) & (items >= 0))
    odd = nth[third] % 2 == 1
    a, b, c = items[third - 2], items[third - 1], items[third]
    faces = np.stack([np.where(odd, b, a), np.where(odd, a, b), c], axis=1)
    return faces[(a != b) & (b != c) & (a != c)]  # repeated corners only steer the strip


@njit(cache=True, nogil=True)
def _walk(
    data: U8,
    sizes: I64,
    wanted: int,
    swapped: bool,
    signed: bool,
    counts: I64,
    items: I64,
) -> tuple[int, int]:
    """Rows and list items of one column; fills in the items if there is room for them."""
    at = total = 0
    for row in range(len(counts)):
        for column in range(len(sizes)):
            count_size, size = sizes[column]
            listed = 1
            if count_size:
                if at + count_size > len(data):
                    return row, total
                listed = _number(data, at, count_size, swapped, False)
                at += count_size
            if listed < 0 or listed > (len(data) - at) // size:
                return row, total
            if column == wanted:
                counts[row] = listed
                if len(items):
                    for i in range(listed):
                        items[total + i] = _number(data, at + i * size, size, swapped, signed)
                total += listed
            at += listed * size
    return len(counts), total


@njit(cache=True, nogil=True, inline="always")
def _number(data: U8, at: int, size: int, swapped: bool, signed: bool) -> int:
    value = np.int64(0)
    for byte in range(size):
        shift = 8 * (size - 1 - byte if swapped else byte)
        value |= np.int64(data[at + byte]) << shift
    if signed and size < 8 and value >> (8 * size - 1):
        value -= np.int64(1) << (8 * size)
    return int(value)
