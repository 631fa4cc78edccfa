"""Header of a PLY file: what the file holds, in which types, and where its data begins.

Format: [Turk 1994, The PLY polygon file format]; the type names with sizes (``float32``) came
later and mean the same.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

CODES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
}
"""numpy's code for each of Turk's type names."""

_CODES = CODES | {np.dtype(code).name: code for code in CODES.values()}
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class PlyProperty:
    """A named number, or list of numbers, in each row of an element."""

    name: str
    dtype: np.dtype[Any]
    """Of the number or of the list's items, in the file's byte order."""
    count_dtype: np.dtype[Any] | None = None
    """Of a list's length, in the file's byte order; None for a single number."""


@dataclass(frozen=True)
class PlyElement:
    """A table of rows with the same properties: vertices, faces..."""

    name: str
    count: int
    """Rows."""
    properties: tuple[PlyProperty, ...]

    @property
    def has_lists(self) -> bool:
        """Whether the length of a row may vary."""
        return any(prop.count_dtype is not None for prop in self.properties)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of a binary row.

        Raises
        ------
        ValueError
            If the element has lists: the rows then differ in length.
        """
        if self.has_lists:
            raise ValueError(f"element '{self.name}' has lists: its rows have no common type")
        return np.dtype([(prop.name, prop.dtype) for prop in self.properties])


@dataclass(frozen=True)
class PlyHeader:
    """What a PLY file says about itself."""

    elements: tuple[PlyElement, ...]
    """In the order of their data."""
    text: bool
    """Whether the data are ascii."""
    data_offset: int
    """Byte at which the data begin."""
    comments: tuple[str, ...] = ()
    """Lines ``comment`` and ``obj_info``."""
    encoding: str = "ascii"
    """As the format line calls it."""


def parse_header(head: bytes) -> PlyHeader:
    r"""Parse the beginning of a PLY file, which must hold the whole header.

    Lines may end with ``\n``, ``\r\n`` or ``\r``. How the first line ends is how ``end_header``
    ends: the data behind it may begin with any byte, also with that of a line end.

    Raises
    ------
    ValueError
        If this is no PLY file or its header is broken; the message names the line.
    """
    first = re.match(rb"ply[ \t]*(\r\n|\n|\r)", head)
    if first is None:
        raise ValueError("not a PLY file, it does not begin with 'ply'")
    line_end = re.escape(first[1])
    last = re.compile(line_end + rb"end_header[ \t]*" + line_end).search(head, first.start(1))
    if last is None:
        raise ValueError("the PLY header has no 'end_header' line")
    # Comments may be in any encoding
    lines = head[first.end() : last.start()].decode("utf-8", "backslashreplace")
    order: str | None = None
    tables: dict[str, tuple[int, dict[str, PlyProperty]]] = {}
    comments: list[str] = []
    for number, line in enumerate(lines.split(first[1].decode()), start=2):
        words = line.split()
        try:
            if not words:
                continue
            if words[0] in ("comment", "obj_info"):
                comments.append(line.partition(words[0])[2].strip())
            elif order is None:
                order = _byte_order(words)
            elif words[0] == "element":
                name, count = _element(words)
                _add(tables, name, (count, {}))
            else:
                if not tables:
                    raise ValueError("belongs to no element")
                prop = _property(words, order)
                _add(list(tables.values())[-1][1], prop.name, prop)
        except ValueError as error:
            text = " ".join(words)
            raise ValueError(f"broken PLY header, line {number} '{text}': {error}") from None
    if order is None:
        raise ValueError("broken PLY header: no 'format' line")
    encoding = next(name for name, sign in _BYTE_ORDERS.items() if sign == order).replace("_", " ")
    elements = tuple(
        PlyElement(name, count, tuple(properties.values()))
        for name, (count, properties) in tables.items()
    )
    return PlyHeader(elements, order == "=", last.end(), tuple(comments), encoding)


def _byte_order(words: list[str]) -> str:
    match words:
        case ["format", encoding, "1.0"] if encoding in _BYTE_ORDERS:
            return _BYTE_ORDERS[encoding]
        case _:
            raise ValueError(f"not 'format' with one of {', '.join(_BYTE_ORDERS)} and '1.0'")


def _element(words: list[str]) -> tuple[str, int]:
    match words:
        case [_, name, count] if re.fullmatch("[0-9]{1,18}", count):
            return name, int(count)
        case _:
            raise ValueError("not 'element' with a name and a number of rows")


def _property(words: list[str], order: str) -> PlyProperty:
    match words:
        case ["property", "list", count_type, item_type, name]:
            count_dtype = _dtype(count_type, order)
            if count_dtype.kind == "f":
                raise ValueError(f"'{count_type}' cannot count the items of a list")
            return PlyProperty(name, _dtype(item_type, order), count_dtype)
        case ["property", number_type, name]:
            return PlyProperty(name, _dtype(number_type, order))
        case _:
            raise ValueError("not a 'property' with its type and name")


def _dtype(type_name: str, order: str) -> np.dtype[Any]:
    if type_name not in _CODES:
        raise ValueError(f"no type '{type_name}' in PLY; types are {', '.join(CODES)}")
    return np.dtype(order + _CODES[type_name])


def _add(table: dict[str, Any], name: str, value: object) -> None:
    if name in table:
        raise ValueError(f"a second '{name}'")
    table[name] = value
