"""Clouds as lines of numbers: XYZ, TXT, CSV, ASC, PTS, and the vertices of OBJ files.

There is no standard: columns are separated by blanks, commas, semicolons or tabs, decimals by a
point or a comma, exponents written with E or Fortran's D, numbers may be quoted, a title and lines
of names and units may stand first, a name, a date or a running number before each point, a label
behind it, and PTS puts the number of points before each of its scans.
"""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.ingest.readers.coordinates import Coordinates, beside, from_text, from_unit
from spinpipe.stages.ingest.readers.point_fields import full_colour, to_8_bit
from spinpipe.stages.ingest.readers.scene_source import About, Chunk, white
from spinpipe.stages.stage import StageError

_HEAD_LINES = 200
_NUMBER = re.compile(rb"[-+]?(\d+\.?\d*|\.\d+)([ed][-+]?\d+)?|[-+]?nan|[-+]?inf", re.I)
_DECIMAL_COMMA = re.compile(rb"[-+]?\d*,\d+([ed][-+]?\d+)?", re.I)
_FORTRAN = re.compile(rb"[-+]?(\d+\.?\d*|\.\d+)d[-+]?\d+", re.I)
_MISSING = re.compile(rb"|null|none|#?n/?a|-+|\?", re.I)
"""What stands where there is no number: the point has none."""
_MOST_BEFORE = 2
"""Words before the coordinates: a name, or date and time."""
_COMMENTS = (b"#", b"//", b"%", b"!")
_NAMES = {
    "x": "x|e|east(ing)?|px|x_?coord\\w*|lon(gitude)?",
    "y": "y|n|north(ing)?|py|y_?coord\\w*|lat(itude)?",
    "z": "z|h|elev(ation)?|height|alt(itude)?|pz|z_?coord\\w*",
    "red": "r|red|diffuse_red",
    "green": "g|green|diffuse_green",
    "blue": "b|blue|diffuse_blue",
}
_UNIT = re.compile(r"[\s_]*[\[(]([^\])]*)[\])]$|[\s_]+([a-z]+)$")
"""Behind the name of a column, in brackets or not."""


@dataclass(frozen=True)
class _Layout:
    """How a line is to be read."""

    separator: bytes | None
    """None: blanks."""
    decimal_comma: bool
    fortran: bool
    """Whether exponents are written with D."""
    names: tuple[str, ...]
    """Of the columns, lower case; empty where the file names none."""
    columns: tuple[int, ...]
    """x, y, z and, where there are colours, red, green, blue."""
    skipped: int
    """Lines before the first row."""
    counts: int | None
    """Points that the file said by then to have; None where it does not."""


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
        head = list(itertools.islice(_lines(path), 100_000 if prefix else _HEAD_LINES))
        self._layout = self._understand(head)
        self.coloured = len(self._layout.columns) == 6
        self._promised = self._layout.counts or 0
        self.points = sum(len(lines) for _, lines in self._blocks(1 << 20))
        if self.points < self._promised:
            raise StageError(
                f"{path}: cut short, {self._promised - self.points:,} of {self._promised:,} points "
                "are missing; copy or export the file again"
            )
        notes = ()
        if self._promised and self.points > self._promised:
            notes = (f"its header says {self._promised:,} points, {self.points:,} are there",)
        self._full: float | None = None
        named = self._layout.names
        comments = [line.decode("utf-8", "replace") for line in head if _is_comment(line)]
        told = beside(path) or from_text(comments, "a comment in the file")
        dialect = {None: "blanks", b",": "commas", b";": "semicolons"}[self._layout.separator]
        self.about = About(
            kind=f"{'OBJ vertices' if prefix else 'text'}, columns parted by {dialect}"
            + (", decimal commas" if self._layout.decimal_comma else ""),
            fields=tuple(n for i, n in enumerate(named) if i not in self._layout.columns),
            coordinates=told or _by_names([named[i] for i in self._layout.columns[:3] if named]),
            notes=notes,
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
        skipped, counts, names = 0, None, ()
        for number, raw in enumerate(head):
            line = self._stripped(raw)
            if line is None:
                skipped += 1
                continue
            separator, decimal_comma = _separator(line)
            words = _words(line, separator, decimal_comma)
            numeric = [_NUMBER.fullmatch(word) is not None for word in words]
            columns = _named_columns(names)
            if columns and max(columns) < len(words):
                row = all(
                    numeric[column] or _MISSING.fullmatch(words[column]) for column in columns
                )
            else:
                columns = ()
                row = self._is_point(numeric, head[number + 1 : number + 4])
            if row:
                if self._prefix and len(words) == 6:  # vertices with colours, OBJ has no others
                    columns = tuple(range(6))
                if not columns:
                    sample = [self._stripped(row) for row in head[number : number + 50]]
                    columns = _guessed_columns(
                        [_words(one, separator, decimal_comma) for one in sample if one]
                    )
                names = names if len(names) >= len(words) else ()
                fortran = any(_FORTRAN.fullmatch(word) for word in words)
                return _Layout(separator, decimal_comma, fortran, names, columns, skipped, counts)
            if len(words) == 1 and words[0].isdigit():
                counts = int(words[0])
            elif 2 * sum(numeric) >= len(words) or self._prefix:
                raise StageError(
                    f"{self._path}: line {number + 1} is no point ('{_short(line)}'); "
                    "each line needs x, y and z"
                )
            else:
                found = tuple(w.strip(b"' /").decode("utf-8", "replace").lower() for w in words)
                if _named_columns(names) and not _named_columns(found):
                    # their units, where it is a line of them
                    found = (
                        tuple(map("{} [{}]".format, names, found))
                        if len(found) == len(names)
                        else names
                    )
                names = found if any(re.match(r"[a-z]", name) for name in found) else names
            skipped += 1
        raise StageError(f"{self._path}: no line holds x, y and z; export it again")

    def _is_point(self, numeric: list[bool], next_lines: list[bytes]) -> bool:
        """Three numbers, with labels behind them only where the next lines have them there, too."""
        begin = _first_of_three(numeric)
        if begin is None or all(numeric[begin:]):
            return begin is not None
        rows = [row for line in next_lines if (row := self._stripped(line)) is not None]
        others = [[bool(_NUMBER.fullmatch(w)) for w in _words(r, *_separator(r))] for r in rows]
        return bool(others) and all(_first_of_three(other) == begin for other in others)

    def _stripped(self, raw: bytes) -> bytes | None:
        """The numbers of a line; None where it is empty, a comment or something else."""
        line = raw.strip(b"\r\n\t ").removeprefix(b"\xef\xbb\xbf").replace(b'"', b"")
        if self._prefix:
            first, *rest = line.split(None, 1)[:2] or [b""]
            return rest[0] if rest and first == self._prefix else None
        return line if line and not _is_comment(line) else None

    def _blocks(self, points: int) -> Iterator[tuple[int, list[bytes]]]:
        """Lines that should be points, and the number of points before them."""
        lines = itertools.islice(_lines(self._path), self._layout.skipped, None)
        rows = (line for raw in lines if (line := self._stripped(raw)) is not None)
        if self._layout.counts is not None:
            rows = self._without_counts(rows)
        start = 0
        while block := list(itertools.islice(rows, points)):
            yield start, block
            start += len(block)

    def _without_counts(self, rows: Iterable[bytes]) -> Iterator[bytes]:
        """Rows, without the numbers of points that stand before each further scan."""
        promised = self._layout.counts or 0
        for row in rows:
            if row.isdigit():
                promised += int(row)
            else:
                yield row
        self._promised = promised

    def _rows(self, points: int) -> Iterator[F64]:
        layout = self._layout
        for start, lines in self._blocks(points):
            if layout.decimal_comma:
                lines = [line.replace(b",", b".") for line in lines]
            if layout.fortran:
                lines = [line.replace(b"D", b"E").replace(b"d", b"e") for line in lines]
            try:
                yield self._parsed(lines)
            except _UNREADABLE:
                try:
                    yield self._parsed([_filled(line, layout.separator) for line in lines])
                except _UNREADABLE as error:
                    raise StageError(
                        f"{self._path}: cannot read points {start:,} to {start + len(lines):,} of "
                        f"{self.points:,} ({error}); the file may be cut short or damaged there, "
                        "copy or export it again"
                    ) from None

    def _parsed(self, lines: list[bytes]) -> F64:
        delimiter = self._layout.separator.decode() if self._layout.separator else None
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return np.loadtxt(
                lines, comments=None, delimiter=delimiter, usecols=self._layout.columns, ndmin=2
            )


_UNREADABLE = (ValueError, UnicodeDecodeError, Warning)


def _lines(path: Path) -> Iterator[bytes]:
    """Lines of a file, which on old Macs ended with CR alone."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
        file.seek(0)
        if b"\n" in head or b"\r" not in head:
            yield from file
            return
    with path.open(encoding="latin-1", newline="\r") as text:
        for line in text:
            yield line.encode("latin-1")


def _filled(line: bytes, separator: bytes | None) -> bytes:
    """A line with ``nan`` where a number is missing."""
    words = line.split(separator)
    filled = [b"nan" if _MISSING.fullmatch(word.strip()) else word for word in words]
    return (separator or b" ").join(filled)


def _first_of_three(numeric: list[bool]) -> int | None:
    """Where the first three numbers in a row begin; None where there are none near the front."""
    firsts = range(min(len(numeric) - 2, _MOST_BEFORE + 1))
    return next((i for i in firsts if all(numeric[i : i + 3])), None)


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
    if len(words) > 1 and not words[-1]:
        del words[-1]
    return [word.replace(b",", b".") for word in words] if decimal_comma else words


def _named_columns(names: tuple[str, ...]) -> tuple[int, ...]:
    """Columns of x, y, z and the colours by their names; none where x, y or z is missing."""
    plain = [_name_and_unit(name)[0] for name in names]
    found: dict[str, int] = {}
    for wanted, patterns in _NAMES.items():
        for pattern in patterns.split("|"):
            for i, name in enumerate(plain):
                if wanted not in found and re.fullmatch(pattern, name):
                    found[wanted] = i
    colours = ("red", "green", "blue")
    wanted = ("x", "y", "z", *(colours if set(colours) <= set(found) else ()))
    return tuple(found[name] for name in wanted) if set(wanted) <= set(found) else ()


def _name_and_unit(name: str) -> tuple[str, Coordinates | None]:
    """``x [ft]`` and ``x_ft`` are x in feet; ``x_coord`` is a name."""
    match = _UNIT.search(name)
    if match is None:
        return name, None
    unit = from_unit((match[1] or match[2] or "").strip(), "names of the columns")
    return (name[: match.start()], unit) if unit or match[2] is None else (name, None)


def _guessed_columns(table: list[list[bytes]]) -> tuple[int, ...]:
    """Columns of x, y, z and the colours of unnamed ones, by the words of the first rows.

    A name or a running number may stand first, intensity between coordinates and colours. Colours
    are whole numbers up to 255 of which one is over 1, or 0 to 1 and not the components of normals.
    """
    count = len(table[0])
    table = [words for words in table if len(words) == count]
    first = [words[0] for words in table]
    running = [b"%d" % (int(first[0]) + i) for i in range(len(first))] if first[0].isdigit() else []
    numbered = len(first) > 2 and first == running
    begin = _first_of_three([bool(_NUMBER.fullmatch(word)) for word in table[0]]) or 0
    begin = 1 if not begin and numbered and count > 3 else begin
    for red in {6: (3,), 7: (4, 3)}.get(count - begin, (3,) if count - begin > 7 else ()):
        rows = [words[begin + red : begin + red + 3] for words in table]
        if _are_colours(rows):
            return tuple(begin + i for i in (0, 1, 2, red, red + 1, red + 2))
    return (begin, begin + 1, begin + 2)


def _are_colours(rows: list[list[bytes]]) -> bool:
    cells = [word for words in rows for word in words]
    if all(re.fullmatch(rb"\d{1,3}(\.0*)?", word) for word in cells):
        return 1 < max(map(float, cells)) < 256
    if not all(re.fullmatch(rb"(0?\.\d+|[01](\.\d*)?)(e-\d+)?", word, re.I) for word in cells):
        return False
    lengths = np.linalg.norm(np.array([[float(word) for word in words] for words in rows]), axis=1)
    return not np.allclose(lengths, 1, atol=0.02) and float(max(map(float, cells))) > 0


def _by_names(names: list[str]) -> Coordinates:
    """What the names of x, y and z say of their units."""
    if names and re.match("lon|lat", names[0]):
        return Coordinates(degrees=True, source="names of the columns")
    units = [unit for _, unit in map(_name_and_unit, names) if unit and unit.metres]
    if len(units) < 3:
        return Coordinates()
    x, y, z = (unit.metres[0] for unit in units if unit.metres)
    return replace(units[0], metres=(x, y, z))


def _short(line: bytes) -> str:
    return line[:40].decode("utf-8", "replace")
