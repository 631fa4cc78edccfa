"""Sparse models of other tools: Bundler's ``bundle.out``, PMVS's ``.patch``, OpenSfM's JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.poses import Cameras
from spinpipe.stages.ingest.readers.scene_source import About, MemorySource
from spinpipe.stages.stage import StageError

_DAMAGE = (ValueError, TypeError, AttributeError, LookupError, ArithmeticError, StopIteration,
           RecursionError)  # fmt: skip
"""What text and JSON of another shape than it should have leads to."""
_FLIP = np.diag([1.0, -1.0, -1.0])
"""Bundler's cameras look along -z with +y up; ours along +z with -y up."""


def read_sfm(path: Path, kind: str) -> MemorySource:
    """Points and cameras of a sparse model.

    Parameters
    ----------
    path : Path
    kind : ``bundler``, ``patch`` or ``opensfm``

    Raises
    ------
    StageError
        When the file is damaged, cut short or has no points.
    """
    readers: dict[str, tuple[Callable[[Path], MemorySource], str]] = {
        "bundler": (_bundler, "Bundler file"),
        "patch": (_patches, "PMVS patch file"),
        "opensfm": (_opensfm, "OpenSfM reconstruction"),
    }
    reader, name = readers[kind]
    try:
        source = reader(path)
    except _DAMAGE as error:
        what = "it ends too early" if isinstance(error, StopIteration) else f"{error}"
        raise StageError(
            f"{path}: cannot read the {name} ({' '.join(what.split())}); it may be cut short, "
            "copy or export it again"
        ) from None
    if not source.points:
        raise StageError(f"{path}: the {name} has no points; export it again")
    return source


def _rows(path: Path) -> Iterator[list[bytes]]:
    with path.open("rb") as file:
        for line in file:
            words = line.split()
            if words and not words[0].startswith(b"#"):
                yield words


def _count(words: list[bytes], path: Path) -> int:
    """A number of rows, which a file of that size can have."""
    count = int(words[0])
    if not 0 <= count <= path.stat().st_size:
        raise ValueError(f"it claims {count:,} rows")
    return count


def _bundler(path: Path) -> MemorySource:
    """[Snavely, Bundler v0.4 user's manual, appendix A]: 5 lines a camera, 3 a point."""
    rows = _rows(path)
    head = next(rows)
    cameras, points = _count(head, path), _count(head[1:], path)
    poses = np.empty((cameras, 5, 3))
    for camera in range(cameras):
        for line in range(5):
            poses[camera, line] = [float(word) for word in next(rows)]
    xyz, rgb = np.empty((points, 3)), np.empty((points, 3), np.uint8)
    for point in range(points):
        xyz[point] = [float(word) for word in next(rows)]
        rgb[point] = [int(word) for word in next(rows)]
        next(rows)  # where it was seen
    used = poses[:, 0, 0] > 0  # a focal length of 0: the photo was not placed
    names = tuple(f"camera {camera}" for camera in np.flatnonzero(used))
    cameras = _cameras(_FLIP @ poses[used, 1:4], poses[used, 4] @ _FLIP, names)
    about = About(kind="Bundler model", cameras=cameras)
    return MemorySource(about, xyz, rgb)


def _patches(path: Path) -> MemorySource:
    """[Furukawa, PMVS-2 documentation]: PATCHS, position, normal, score, two lists of images."""
    rows = _rows(path)
    if next(rows) != [b"PATCHES"]:
        raise ValueError("it does not begin with PATCHES")
    points = _count(next(rows), path)
    xyz = np.empty((points, 3))
    row = next(rows, [])
    for point in range(points):
        if row != [b"PATCHS"]:
            raise ValueError(f"patch {point:,} of {points:,} is missing")
        x, y, z, w = (float(word) for word in next(rows))
        xyz[point] = np.array([x, y, z]) / w
        normal = next(rows)
        if len(normal) != 4 or len(next(rows)) != 3:
            raise ValueError(f"patch {point:,} of {points:,} is damaged")
        for row in rows:
            if row == [b"PATCHS"]:
                break
    return MemorySource(About(kind="PMVS patches", fields=("normal", "score")), xyz)


def _opensfm(path: Path) -> MemorySource:
    """The first reconstruction of OpenSfM's ``reconstruction.json``, its largest."""
    document: Any = json.loads(path.read_bytes())
    model = document[0] if isinstance(document, list) else document
    points = list(model.get("points", {}).values())
    xyz = np.array([point["coordinates"] for point in points], np.float64).reshape(-1, 3)
    rgb = np.array([point.get("color", (255, 255, 255)) for point in points]).reshape(-1, 3)
    named = {name: shot for name, shot in model.get("shots", {}).items() if "rotation" in shot}
    shots = named.values()
    turns = np.array([shot["rotation"] for shot in shots], np.float64).reshape(-1, 3)
    moves = np.array([shot["translation"] for shot in shots], np.float64).reshape(-1, 3)
    cameras = _cameras(Rotation.from_rotvec(turns).as_matrix(), moves, tuple(named))
    notes = ()
    if isinstance(document, list) and len(document) > 1:
        notes = (f"the first of {len(document)} reconstructions in the file",)
    about = About(
        kind="OpenSfM model",
        cameras=cameras,
        notes=notes,
        # OpenSfM aligns to GPS or to the horizon: local east, north, up in metres
        up=(0.0, 0.0, 1.0) if "reference_lla" in model else None,
        up_reason="OpenSfM: aligned to GPS, z is up" if "reference_lla" in model else "",
    )
    return MemorySource(about, xyz, np.clip(rgb, 0, 255).astype(np.uint8))


def _cameras(rotations: F64, translations: F64, names: tuple[str, ...]) -> Cameras | None:
    return Cameras(*camera_poses(rotations, translations), names) if names else None


def camera_poses(rotations: F64, translations: F64) -> tuple[F64, F64]:
    """Positions (C, 3) and quaternions xyzw (C, 4) camera -> scene from ``x_cam = R x + t``."""
    positions = -np.einsum("cji,cj->ci", rotations, translations)
    return positions, Rotation.from_matrix(rotations).inv().as_quat()
