"""LAS and LAZ clouds, as OpenDroneMap and survey tools write them."""

# laspy's types are incomplete
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.records import F64, U8
from spinpipe.stages.ingest.colour_range import full_colour, to_8_bit
from spinpipe.stages.stage import StageError


class LasSource:
    """The points of a LAS or LAZ file, in the units of its coordinate system.

    Raises
    ------
    StageError
        When the file cannot be read.
    """

    cameras = None

    def __init__(self, path: Path) -> None:
        import laspy  # heavy: only where needed

        self._path = path
        try:
            with laspy.open(path) as reader:
                self.points = reader.header.point_count
                names = set(reader.header.point_format.dimension_names)
        except Exception as error:  # laspy and its decompressor raise many kinds
            raise self._unreadable(error) from error
        self.coloured = {"red", "green", "blue"} <= names
        self._full: float | None = None

    def chunks(self, points: int) -> Iterator[tuple[F64, U8]]:
        """Points in the file's order, at most ``points`` at a time."""
        if self.coloured and self._full is None:
            self._full = full_colour(_colours(records) for records in self._records(points))
        for records in self._records(points):
            xyz = np.column_stack([records.x, records.y, records.z]).astype(np.float64)
            if self._full is None:
                yield xyz, np.full((len(xyz), 3), 255, np.uint8)
            else:
                yield xyz, to_8_bit(_colours(records), self._full)

    def _records(self, points: int) -> Iterator[Any]:
        import laspy

        found = 0
        try:
            with laspy.open(self._path) as reader:
                for records in reader.chunk_iterator(points):
                    found += len(records)
                    yield records
        except Exception as error:
            raise self._unreadable(error) from error
        if found < self.points:
            raise StageError(
                f"{self._path}: cut short, {self.points - found:,} of {self.points:,} points are "
                "missing; copy or export the file again"
            )

    def _unreadable(self, error: Exception) -> StageError:
        return StageError(
            f"{self._path}: cannot read the LAS file ({' '.join(str(error).split())}); "
            "it may be cut short, copy or export it again"
        )


def _colours(records: Any) -> NDArray[Any]:
    return np.column_stack([records.red, records.green, records.blue])
