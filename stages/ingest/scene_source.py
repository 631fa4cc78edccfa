"""Where a scene comes from: one reader a format behind one small protocol.

A reader yields the points in chunks, so that memory does not grow with the scene, and can be
asked for them several times.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Protocol

from spinpipe.schemas.records import F64, U8
from spinpipe.stages.ingest import read_colmap, read_las, read_ply
from spinpipe.stages.stage import StageError

Chunk = tuple[F64, U8]
"""Coordinates (N, 3) float64 in the scene frame, not necessarily finite, and colours (N, 3)."""


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
    def cameras(self) -> tuple[F64, F64] | None:
        """Positions (C, 3) in the scene frame and quaternions xyzw (C, 4) camera -> scene."""
        ...

    def chunks(self, points: int) -> Iterator[Chunk]:
        """All points in the file's order, at most ``points`` at a time.

        Raises
        ------
        StageError
            When the file cannot be read to its end.
        """
        ...


_READERS: dict[str, Callable[[Path], SceneSource]] = {
    ".ply": read_ply.PlySource,
    ".las": read_las.LasSource,
    ".laz": read_las.LasSource,
}


def open_scene(path: Path) -> SceneSource:
    """Open a cloud: a PLY, LAS or LAZ file, or the folder of a COLMAP model.

    Raises
    ------
    StageError
        When the path does not exist, is of no known kind or cannot be read.
    """
    if path.is_dir():
        return read_colmap.ColmapSource(path)
    if not path.exists():
        raise StageError(f"{path}: no such file or folder; correct the path in the config")
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        known = ", ".join(_READERS)
        raise StageError(
            f"{path}: cannot read a scene from '{path.suffix}' files; "
            f"give one of {known} or the folder of a COLMAP model"
        )
    return reader(path)
