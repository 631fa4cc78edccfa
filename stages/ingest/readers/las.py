"""LAS and LAZ clouds, as OpenDroneMap and survey tools write them."""

# laspy's types are incomplete
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F64
from spinpipe.stages.ingest.readers.coordinates import Coordinates, beside, from_crs
from spinpipe.stages.ingest.readers.data_kind import left_over
from spinpipe.stages.ingest.readers.guarded import MOST_POINTS, guarded, readable
from spinpipe.stages.ingest.readers.point_fields import full_colour, to_8_bit
from spinpipe.stages.ingest.readers.scene_source import About, Chunk, white
from spinpipe.stages.stage import StageError

_VLR_HEADER = 54
"""Bytes of the header of a variable length record [ASPRS LAS 1.4 R15, table 7]."""
_SHORTEST_HEADER = 227
_SHOWN = ("X", "Y", "Z", "red", "green", "blue")
"""Fields that come out as coordinates and colours."""


class LasSource:
    """The points of a LAS or LAZ file, in the units of its coordinate system.

    Raises
    ------
    StageError
        When the file cannot be read.
    """

    def __init__(self, path: Path) -> None:
        # imported here once, not in each child
        import laspy  # noqa: F401  # pyright: ignore[reportUnusedImport]

        self._path = path
        self._counted = _check_header(path)
        header = next(iter(guarded(_header, path)))
        self.points, names, compressed = header.points, header.names, header.compressed
        told = header.told or beside(path) or Coordinates()
        notes: tuple[str, ...] = ()
        if not self.points and self._counted:
            if compressed:
                raise StageError(
                    f"{path}: its header says 0 points though data follow; rewrite it, "
                    "with 'lasinfo -repair' or 'pdal translate'"
                )
            self.points = self._counted
            notes = (f"its header says 0 points, {self.points:,} are there: read them",)
        elif header.nothing_follows and not compressed and self._counted > self.points:
            notes = left_over(self._counted, self.points, 1, self.points)
        self.coloured = {"red", "green", "blue"} <= set(names)
        self._full: float | None = None
        self.about = About(
            kind=header.kind,
            fields=tuple(n for n in names if n not in _SHOWN),
            coordinates=told,
            # The standard leaves it open, but z is the height wherever the system has one
            up=None if told.geocentric else (0.0, 0.0, 1.0),
            up_reason="LAS: z is the height",
            notes=notes,
        )

    def chunks(self, points: int) -> Iterator[Chunk]:
        """Points in the file's order, at most ``points`` at a time."""
        if self.coloured and self._full is None:
            self._full = full_colour(rgb for _, rgb in self._records(points) if rgb is not None)
        for xyz, rgb in self._records(points):
            if self._full is None or rgb is None:
                yield xyz, white(len(xyz))
            else:
                yield xyz, to_8_bit(rgb, self._full)

    def _records(self, points: int) -> Iterator[tuple[F64, NDArray[Any] | None]]:
        found = 0
        points = min(points, MOST_POINTS)
        for xyz, rgb in guarded(_points, self._path, points, self.points, self.coloured):
            found += len(xyz)
            yield xyz, rgb
        if found < self.points:
            raise StageError(
                f"{self._path}: cut short, {self.points - found:,} of {self.points:,} points are "
                "missing; copy or export the file again"
            )


@dataclass(frozen=True)
class _Header:
    points: int
    names: list[str]
    compressed: bool
    kind: str
    told: Coordinates | None
    nothing_follows: bool
    """Whether the points are the last of the file; newer versions may have records behind them."""


def _header(path: Path) -> Iterator[_Header]:
    import laspy

    with readable(path, "LAS file"), laspy.open(path) as reader:
        header = reader.header
        compressed = header.are_points_compressed
        yield _Header(
            header.point_count,
            list(header.point_format.dimension_names),
            compressed,
            f"{'LAZ' if compressed else 'LAS'} {header.version}, "
            f"point format {header.point_format.id}",
            _coordinates(header),
            header.version.minor <= 2,
        )


def _points(
    path: Path, points: int, total: int, coloured: bool
) -> Iterator[tuple[F64, NDArray[Any] | None]]:
    """Coordinates (N, 3) and colours (N, 3) as they are, piece by piece."""
    import laspy

    # in this thread: a pool that the parent has started does not live on in a fork
    alone = laspy.LazBackend.Lazrs
    with readable(path, "LAS file"), laspy.open(path, laz_backend=alone) as reader:
        reader.header.point_count = total  # a header may say 0
        for records in reader.chunk_iterator(points):
            xyz = np.empty((len(records), 3))
            for column, axis in enumerate((records.x, records.y, records.z)):
                xyz[:, column] = np.asarray(axis, np.float64)
            yield xyz, _colours(records) if coloured else None


def _check_header(path: Path) -> int:
    """How many points fit behind the header; refuses one that lies about its size.

    A reader that believes in billions of records walks for hours.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_SHORTEST_HEADER)
    if len(head) < _SHORTEST_HEADER:
        raise StageError(
            f"{path}: cannot read the LAS file (its header is incomplete); it is cut short, copy "
            "or export it again"
        )
    header_size, offset, records = struct.unpack_from("<HII", head, 94)
    (row,) = struct.unpack_from("<H", head, 105)
    if header_size + records * _VLR_HEADER > min(offset, size) or offset > size or not row:
        raise StageError(
            f"{path}: cannot read the LAS file (its header claims {records:,} records before the "
            f"points at byte {offset:,} of {size:,}); it may be cut short, copy or export it again"
        )
    scales = struct.unpack_from("<3d", head, 131)
    if not all(0 < abs(scale) < float("inf") for scale in scales):
        raise StageError(
            f"{path}: its header says that coordinates are multiples of {scales[0]:g}, "
            f"{scales[1]:g} and {scales[2]:g}; export it again"
        )
    return (size - offset) // row


def _coordinates(header: Any) -> Coordinates | None:
    """System by the file's records, WKT or GeoTIFF keys; one that PROJ does not know is none."""
    from pyproj.exceptions import CRSError

    try:
        crs = header.parse_crs()
    except (CRSError, ValueError, KeyError):
        return None
    return from_crs(crs, "LAS header") if crs else None


def _colours(records: Any) -> NDArray[Any]:
    return np.column_stack([records.red, records.green, records.blue])
