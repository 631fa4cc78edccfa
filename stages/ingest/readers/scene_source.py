"""What every reader of a scene gives: its points piece by piece, and what the file says of itself.

Pieces keep memory from growing with the scene; a source can be asked for them several times.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from spinpipe.schemas.arrays import F64, U8
from spinpipe.schemas.poses import Calibration, Cameras, Trajectory
from spinpipe.schemas.records import Vector
from spinpipe.stages.ingest.readers.coordinates import Coordinates

Chunk = tuple[F64, U8]
"""Coordinates (N, 3) float64 in the scene frame, not necessarily finite, and colours (N, 3)."""


@dataclass(frozen=True)
class About:
    """What a file says of itself beyond its points."""

    kind: str
    """Format and dialect, as the user would name it."""
    fields: tuple[str, ...] = ()
    """Names of what each point carries besides its coordinates."""
    coordinates: Coordinates = field(default_factory=Coordinates)
    """Unit and coordinate system as far as the file tells."""
    up: Vector | None = None
    """Which way is up by the format's specification, scene frame."""
    up_reason: str = ""
    cameras: Cameras | None = None
    """In the scene frame."""
    calibrations: tuple[Calibration, ...] = ()
    """Of the cameras, where they are known."""
    photos: Path | None = None
    """Folder of the photos, where it is known."""
    trajectory: Trajectory | None = None
    """Of a lidar, in the scene frame."""
    notes: tuple[str, ...] = ()
    """What a user should know about how the file was understood."""

    @property
    def known_up(self) -> Vector | None:
        """Up by the format, or because the coordinate system makes z a height."""
        return self.up or ((0.0, 0.0, 1.0) if self.coordinates.z_is_height else None)

    @property
    def known_up_reason(self) -> str:
        """Why."""
        by_system = self.coordinates.z_is_height
        return self.up_reason or (f"{self.coordinates.name}: z is a height" if by_system else "")


class SceneSource(Protocol):
    """A cloud on disk, read piece by piece."""

    @property
    def points(self) -> int:
        """How many points the file says it has."""
        ...

    @property
    def coloured(self) -> bool:
        """Whether the points have colours; they come out white otherwise."""
        ...

    @property
    def about(self) -> About:
        """What the file says of itself."""
        ...

    def chunks(self, points: int) -> Iterator[Chunk]:
        """All points in the file's order, at most ``points`` at a time.

        Raises
        ------
        StageError
            When the file cannot be read to its end.
        """
        ...


@dataclass(frozen=True)
class MemorySource:
    """A cloud that is small enough to be held, as those of sparse models are."""

    about: About
    xyz: F64
    """(N, 3) scene frame."""
    rgb: U8 | None = None
    """(N, 3), or None where there are no colours."""

    @property
    def points(self) -> int:
        """How many points there are."""
        return len(self.xyz)

    @property
    def coloured(self) -> bool:
        """Whether the points have colours."""
        return self.rgb is not None

    def chunks(self, points: int) -> Iterator[Chunk]:
        """All points in order, at most ``points`` at a time."""
        for start in range(0, len(self.xyz), points):
            piece = self.xyz[start : start + points]
            yield piece, white(len(piece)) if self.rgb is None else self.rgb[start : start + points]


_HELD_BYTES = 27
"""A point's coordinates and colours."""


class _Held:
    """Points of another source, kept from when they are first asked for."""

    def __init__(self, source: SceneSource) -> None:
        self._source = source
        self._chunks: list[Chunk] = []
        self.points, self.coloured, self.about = source.points, source.coloured, source.about

    def chunks(self, points: int) -> Iterator[Chunk]:
        """All points in order, in the pieces that were asked for first."""
        if self._chunks:
            yield from self._chunks
            return
        chunks: list[Chunk] = []
        for chunk in self._source.chunks(points):
            chunks.append(chunk)
            yield chunk
        self._chunks = chunks


def held(source: SceneSource, most_bytes: int) -> SceneSource:
    """A source that reads its file once where its points fit into so much memory."""
    return _Held(source) if source.points * _HELD_BYTES <= most_bytes else source


def white(count: int) -> U8:
    """Colours (count, 3) of points that have none."""
    return np.full((count, 3), 255, np.uint8)
