"""Write clouds and meshes as binary little-endian PLY: the same rows give the same bytes.

Format: [Turk 1994, The PLY polygon file format].
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import I32, U8
from spinpipe.stages.ingest.readers.ply_header import CODES

_NAMES = {code: name for name, code in CODES.items()}
_FACE = np.dtype([("count", "u1"), ("vertex_indices", "<i4", 3)])


def write_ply(
    path: Path,
    vertices: NDArray[Any],
    faces: I32 | None = None,
    comment: str = "",
) -> None:
    """Write a PLY file.

    Parameters
    ----------
    path : file to write; replaced if it exists.
    vertices : (N,) structured rows; each field becomes a property of that name and type.
    faces : (F, 3) int32 rows of ``vertices``; without them the file has no element ``face``.
    comment : one line for the header.

    Raises
    ------
    ValueError
        If a field has a type that PLY lacks, or names or comment would break the header.
    """
    vertex = _little_endian(vertices.dtype)
    header = ply_header(vertex, len(vertices), None if faces is None else len(faces), comment)
    tables = [vertices.astype(vertex, copy=False)]
    if faces is not None:
        rows = np.empty(len(faces), _FACE)
        rows["count"] = 3
        rows["vertex_indices"] = faces
        tables.append(rows)
    with path.open("wb") as file:
        file.write(header)
        for table in tables:
            file.write(np.ascontiguousarray(table).view(np.uint8).data)


def ply_header(
    vertex: np.dtype[Any], count: int, faces: int | None = None, comment: str = ""
) -> bytes:
    """Header of a file with ``count`` vertices, and triangles if their number is given."""
    lines = ["ply", "format binary_little_endian 1.0"]
    if comment:
        if not comment.isprintable():
            raise ValueError("the comment must be one printable line")
        lines.append(f"comment {comment}")
    lines.append(f"element vertex {count}")
    lines += [f"property {_NAMES[vertex[name].str[1:]]} {name}" for name in vertex.names or ()]
    if faces is not None:
        lines += [f"element face {faces}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header\n"]).encode()


def cloud_rows(
    xyz: NDArray[np.floating[Any]], rgb: U8 | None = None, number: str = "<f4"
) -> NDArray[Any]:
    """Vertices for ``write_ply``: x, y, z and perhaps red, green, blue.

    Parameters
    ----------
    xyz : (N, 3) coordinates.
    rgb : (N, 3) colours, 0 to 255, or (3,) for all.
    number : numpy's code for the type of the coordinates.
    """
    colours = () if rgb is None else ("red", "green", "blue")
    rows = np.empty(len(xyz), [*((a, number) for a in "xyz"), *((c, "u1") for c in colours)])
    rows["x"], rows["y"], rows["z"] = xyz.T
    if rgb is not None:
        rows["red"], rows["green"], rows["blue"] = rgb.T
    return rows


def _little_endian(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """The same fields without gaps, lowest byte first."""
    fields = [(name, dtype[name].newbyteorder("<")) for name in dtype.names or ()]
    for name, field in fields:
        if field.str[1:] not in _NAMES:
            raise ValueError(f"field '{name}': PLY has no type for {field}")
        if not name.isprintable() or name.split() != [name]:
            raise ValueError(f"field '{name}': PLY needs names without blanks")
    return np.dtype(fields)
