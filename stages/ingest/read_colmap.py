"""COLMAP models: the folder with points3D, images and cameras, binary or text."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from spinpipe.schemas.records import F64, U8
from spinpipe.stages.stage import StageError

_FILES = ("points3D.bin", "points3D.txt")


class ColmapSource:
    """The points of a COLMAP model and where its photos were taken.

    Raises
    ------
    StageError
        When the folder is no COLMAP model, cannot be read or has no points.
    """

    coloured = True

    def __init__(self, folder: Path) -> None:
        if not _is_model(folder):
            raise StageError(_not_a_model(folder))
        import pycolmap  # heavy: only where needed

        try:
            model = pycolmap.Reconstruction(folder)
        except Exception as error:  # the C++ side raises many kinds
            raise StageError(
                f"{folder}: cannot read the COLMAP model ({' '.join(str(error).split())}); "
                "copy or export it again"
            ) from error
        points = [model.points3D[key] for key in sorted(model.points3D)]
        if not points:
            raise StageError(f"{folder}: the COLMAP model has no points; triangulate it first")
        self.points = len(points)
        self._xyz = np.array([point.xyz for point in points], np.float64)
        self._rgb = np.array([point.color for point in points], np.uint8)
        images = [model.images[key] for key in sorted(model.images)]
        poses = [image.cam_from_world().inverse() for image in images if image.has_pose]
        self.cameras: tuple[F64, F64] | None = None
        if poses:
            self.cameras = (
                np.array([pose.translation for pose in poses], np.float64),
                np.array([pose.rotation.quat for pose in poses], np.float64),
            )

    def chunks(self, points: int) -> Iterator[tuple[F64, U8]]:
        """Points in order of their COLMAP ids, at most ``points`` at a time."""
        for start in range(0, self.points, points):
            yield self._xyz[start : start + points], self._rgb[start : start + points]


def _is_model(folder: Path) -> bool:
    return any((folder / name).is_file() for name in _FILES)


def _not_a_model(folder: Path) -> str:
    below = sorted({path.parent for name in _FILES for path in folder.rglob(name)})
    if below:
        found = " or ".join(f"'{path.relative_to(folder)}'" for path in below)
        return f"{folder}: not itself a COLMAP model; give the folder {found} below it"
    return f"{folder}: no COLMAP model (no points3D.bin or points3D.txt); give a cloud or a model"
