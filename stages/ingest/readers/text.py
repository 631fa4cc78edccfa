"""Clouds as lines of numbers: XYZ, TXT, CSV, ASC, PTS, and the vertices of OBJ files.

There is no standard: columns are separated by blanks, commas, semicolons or tabs, decimals by a
point or a comma, a line of names may stand first, and PTS puts the number of points there.
"""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.ingest.readers.coordinates import Coordinates, beside, from_text
from spinpipe.stages.ingest.readers.point_fields import full_colour, to_8_bit
from spinpipe.stages.ingest.readers.scene_source import About, Chunk, white
from spinpipe.stages.stage import StageError

_HEAD_LINES = 200
_NUMBER = re.compile(rb"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?nan|[-+]?inf", re.I)
_DECIMAL_COMMA = re.compile(rb"[-+]?\d*,\d+([eE][-+]?\d+)?")
_COMMENTS = (b"#", b"//", b"%", b"!")
_NAMES = {
    "x": "x|east(ing)?|px|x_?coord\\w*|lon(gitude)?",
    "y": "y|north(ing)?|py|y_?coord\\w*|lat(itude)?",
    "z": "z|elev(ation)?|height|alt(itude)?|pz|z_?coord\\w*",
    "red": "r|red|diffuse_red",
    "green": "g|green|diffuse_green",
    "blue": "b|blue|diffuse_blue",
}


@dataclass(frozen=True)
class _Layout:
    """How a line is to be read."""

    separator: bytes | None
    """None: blanks."""
    decimal_comma: bool
    names: tuple[str, ...]
    """Of the columns, lower case; empty where the file names none."""
    columns: tuple[int, ...]
    """x, y, z and, where there are colours, red, green, blue."""
    skipped: int
    """Lines before the first row."""


class TextSource:
    """A cloud in a text file, one point a line.

    Parameters
    ----------
    path : Path
    prefix : bytes
        Only lines with this first word are points, as ``v`` in OBJ files.

    Raises
    ------
    StageError
        When no line holds three numbers.
    """

    def __init__(self, path: Path, prefix: bytes = b"") -> None:
        self._path = path
        self._prefix = prefix
        with path.open("rb") as file:
            head = list(itertools.islice(file, 100_000 if prefix else _HEAD_LINES))
        self._layout = self._understand(head)
        self.coloured = len(self._layout.columns) == 6
        self.points = sum(len(lines) for _, lines in self._blocks(1 << 20))
        self._full: float | None = None
        named = self._layout.names
        degrees = bool(named) and re.match("lon|lat", named[self._layout.columns[0]]) is not None
        comments = [line.decode("utf-8", "replace") for line in head if _is_comment(line)]
        told = beside(path) or from_text(comments, "a comment in the file")
        dialect = {None: "blanks", b",": "commas", b";": "semicolons"}[self._layout.separator]
        self.about = About(
            kind=f"{'OBJ vertices' if prefix else 'text'}, columns parted by {dialect}"
            + (", decimal commas" if self._layout.decimal_comma else ""),
            fields=tuple(n for i, n in enumerate(named) if i not in self._layout.columns),
            coordinates=told or Coordinates(degrees=degrees, source="names of the columns"),
        )

    def chunks(self, points: int) -> Iterator[Chunk]:
        """Points in the file's order, at most ``points`` at a time."""
        if self.coloured and self._full is None:
            colours = (rows[:, 3:] for rows in self._rows(points))
            # Whole numbers: the type of a text column does not tell
            self._full = full_colour(colours)
        for rows in self._rows(points):
            rgb = white(len(rows)) if self._full is None else to_8_bit(rows[:, 3:], self._full)
            yield np.ascontiguousarray(rows[:, :3]), rgb

    def _understand(self, head: list[bytes]) -> _Layout:
        skipped, names = 0, ()
        for number, raw in enumerate(head):
            line = self._stripped(raw)
            if line is None:
                skipped += 1
                continue
            separator, decimal_comma = _separator(line)
            words = _words(line, separator, decimal_comma)
            if all(_NUMBER.fullmatch(word) for word in words):
                if len(words) < 3 and number < 2:  # PTS begins with the number of points
                    skipped += 1
                    continue
                if len(words) >= 3:
                    columns = self._columns(names, head[number:], len(words))
                    return _Layout(separator, decimal_comma, names, columns, skipped)
            elif not names and not self._prefix:
                names = tuple(
                    w.strip(b"\"' /").decode("utf-8", "replace").lower() for w in words if w
                )
                skipped += 1
                continue
            raise StageError(
                f"{self._path}: line {number + 1} is no point ('{_short(line)}'); "
                "each line needs x, y and z"
            )
        raise StageError(f"{self._path}: no line holds x, y and z; export it again")

    def _columns(self, names: tuple[str, ...], rows: list[bytes], count: int) -> tuple[int, ...]:
        found: dict[str, int] = {}
        for wanted, pattern in _NAMES.items():
            for i, name in enumerate(names[:count]):
                if wanted not in found and re.fullmatch(pattern, name.split("[")[0].strip()):
                    found[wanted] = i
        if {"x", "y", "z"} <= set(found):
            colours = ("red", "green", "blue")
            wanted = ("x", "y", "z", *(colours if set(colours) <= set(found) else ()))
            return tuple(found[name] for name in wanted)
        if names and not any(re.match(r"[a-z]", n) for n in names):
            names = ()
        # x y z r g b, or x y z intensity r g b: whole numbers up to 255
        sample = [self._stripped(row) for row in rows[:50]]
        table = [_words(line, *_separator(line)) for line in sample if line]
        for first in {6: (3,), 7: (4, 3)}.get(count, (3,) if count > 7 else ()):
            cells = [w for words in table if len(words) == count for w in words[first : first + 3]]
            if cells and all(re.fullmatch(rb"\d{1,3}(\.0*)?", w) and float(w) < 256 for w in cells):
                return (0, 1, 2, first, first + 1, first + 2)
        return (0, 1, 2)

    def _stripped(self, raw: bytes) -> bytes | None:
        """The numbers of a line; None where it is empty, a comment or something else."""
        line = raw.strip().removeprefix(b"\xef\xbb\xbf")
        if self._prefix:
            first, _, line = line.partition(b" ")
            return line.strip() if first == self._prefix else None
        return line if line and not _is_comment(line) else None

    def _blocks(self, points: int) -> Iterator[tuple[int, list[bytes]]]:
        """Lines that should be points, and the number of points before them."""
        with self._path.open("rb") as file:
            lines = itertools.islice(file, self._layout.skipped, None)
            rows = (line for raw in lines if (line := self._stripped(raw)) is not None)
            start = 0
            while block := list(itertools.islice(rows, points)):
                yield start, block
                start += len(block)

    def _rows(self, points: int) -> Iterator[F64]:
        layout = self._layout
        for start, lines in self._blocks(points):
            if layout.decimal_comma:
                lines = [line.replace(b",", b".") for line in lines]
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    delimiter = layout.separator.decode() if layout.separator else None
                    yield np.loadtxt(
                        lines, comments=None, delimiter=delimiter, usecols=layout.columns, ndmin=2
                    )
            except (ValueError, UnicodeDecodeError, Warning) as error:
                raise StageError(
                    f"{self._path}: cannot read points {start:,} to {start + len(lines):,} of "
                    f"{self.points:,} ({error}); the file may be cut short or damaged there, "
                    "copy or export it again"
                ) from None


def _is_comment(line: bytes) -> bool:
    """Comments may hold the names of columns (CloudCompare's ``//X,Y,Z``): those are kept."""
    return line.startswith(_COMMENTS) and not re.match(rb"//\s*x\W", line, re.I)


def _separator(line: bytes) -> tuple[bytes | None, bool]:
    """What parts the columns, and whether commas are decimal."""
    if b";" in line:
        return b";", b"," in line
    words = line.split()
    if len(words) >= 3 and any(_DECIMAL_COMMA.fullmatch(w) for w in words):
        return None, True
    return (b",", False) if b"," in line else (None, False)


def _words(line: bytes, separator: bytes | None, decimal_comma: bool) -> list[bytes]:
    words = [word.strip() for word in line.split(separator)]
    return [word.replace(b",", b".") for word in words] if decimal_comma else words


def _short(line: bytes) -> str:
    return line[:40].decode("utf-8", "replace")
