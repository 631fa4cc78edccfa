"""COLMAP models: the folder with points3D, images and cameras, binary or text.

The files are read here and not by COLMAP itself, which hangs on damaged ones and wants all of
them; the formats are those of its documentation [colmap.github.io/format.html]. Newer models have
files for rigs and frames beside them; the images still hold their own poses.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from spinpipe.schemas.poses import Calibration, Cameras
from spinpipe.stages.ingest.readers.coordinates import Coordinates
from spinpipe.stages.ingest.readers.lens import MODELS, calibration
from spinpipe.stages.ingest.readers.ply_lists import ListRows
from spinpipe.stages.ingest.readers.point_fields import xyz_of
from spinpipe.stages.ingest.readers.scene_source import About, Chunk
from spinpipe.stages.ingest.readers.sfm import camera_poses
from spinpipe.stages.stage import StageError

_POINT = [(None, "<u8"), *[(None, "<f8")] * 3, *[(None, "<u1")] * 3, (None, "<f8"), ("<u8", "<u8")]
"""A point of points3D.bin: id, x, y, z, colour, error, and pairs of 32-bit numbers: where seen."""
_SUFFIXES = (".bin", ".txt")
_LEAST_NORM = 1e-6
"""Of a quaternion that means something; COLMAP writes unit ones."""
_EARTH_M = (6.33e6, 6.40e6)
"""From the middle of the Earth to anywhere on it or a little above [WGS 84]."""
_FAR = 1e4
"""Farther from the origin than this in units only a model lies that was put onto a map."""
_NAMES = ("x", "y", "z", "red", "green", "blue")


class ColmapSource:
    """The points of a COLMAP model and where its photos were taken.

    Parameters
    ----------
    path : the folder, or its points3D file.

    Raises
    ------
    StageError
        When the folder is no COLMAP model, cannot be read or has no points.
    """

    coloured = True

    def __init__(self, path: Path) -> None:
        folder = path if path.is_dir() else path.parent
        self._path = path if path.is_file() else points_file(folder)
        self._binary = self._path.suffix == ".bin"
        self.points = self._count()
        if not self.points:
            raise StageError(f"{folder}: the COLMAP model has no points; triangulate it first")
        about = About(kind=f"COLMAP model, {'binary' if self._binary else 'text'}")
        self.about = with_cameras(about, folder)
        if self.about.cameras is None:
            note = "points without cameras: no images and cameras files"
            self.about = replace(self.about, notes=(note,))

    def chunks(self, points: int) -> Iterator[Chunk]:
        """Points in the file's order, at most ``points`` at a time."""
        found = 0
        for rows in self._binary_rows(points) if self._binary else self._text_rows(points):
            found += len(rows)
            yield xyz_of(rows), np.stack([rows[name] for name in _NAMES[3:]], axis=1)
        if found < self.points:
            raise StageError(
                f"{self._path}: cut short, {self.points - found:,} of {self.points:,} points are "
                "missing; copy or export the model again"
            )

    def _count(self) -> int:
        with self._path.open("rb") as file:
            if self._binary:
                head = file.read(8)
                if len(head) < 8:
                    raise _damaged(self._path, "it is cut short")
                return int.from_bytes(head, "little")
            return sum(1 for line in file if line.strip() and not line.startswith(b"#"))

    def _binary_rows(self, points: int) -> Iterator[NDArray[Any]]:
        layout = [(np.dtype(c) if c else None, np.dtype(i)) for c, i in _POINT]
        with self._path.open("rb") as file:
            file.seek(8)
            yield from ListRows(layout, range(1, 7), _NAMES).read(file, self.points, points)

    def _text_rows(self, points: int) -> Iterator[NDArray[Any]]:
        dtype = np.dtype([(n, "f8" if n in "xyz" else "u1") for n in _NAMES])
        rows: list[tuple[Any, ...]] = []
        with self._path.open("rb") as file:
            for number, line in enumerate(file, start=1):
                words = line.split(maxsplit=7)
                if not words or words[0].startswith(b"#"):
                    continue
                try:
                    rows.append((*map(float, words[1:4]), *map(int, words[4:7])))
                    if len(rows[-1]) != 6 or max(rows[-1][3:]) > 255 or min(rows[-1][3:]) < 0:
                        raise ValueError
                except ValueError:
                    raise _damaged(self._path, f"line {number:,} is no point") from None
                if len(rows) == points:
                    yield np.array(rows, dtype)
                    rows = []
        if rows:
            yield np.array(rows, dtype)


def with_cameras(about: About, *folders: Path) -> About:
    """Add the photos of the first of the folders that is a model with any."""
    for folder in folders:
        found = _read_cameras(folder)
        if found is not None:
            cameras, calibrations = found
            photos = _photo_folder(folder, cameras.names[0])
            told = about.coordinates
            if told.metres is None:
                told = _georegistered(cameras) or told
            return replace(
                about, cameras=cameras, calibrations=calibrations, photos=photos, coordinates=told
            )
    return about


def _georegistered(cameras: Cameras) -> Coordinates | None:
    """The unit by where the photos were taken; None where nothing tells.

    COLMAP's own models are a few units wide about their middle; ``model_aligner`` puts them to
    where GPS says, earth-centred, in a plane of the user's map, or about the first photo: the
    latter cannot be told from a model that was never aligned.
    """
    away = float(np.median(np.linalg.norm(cameras.positions, axis=1)))
    if not away > _FAR:
        return None
    geocentric = _EARTH_M[0] < away < _EARTH_M[1]
    return Coordinates(
        name=f"georegistered, {'earth-centred metres' if geocentric else 'metres of a map'}",
        metres=(1.0, 1.0, 1.0),
        geocentric=geocentric,
        source=f"the photos lie {away:,.0f} units from the origin",
    )


def _read_cameras(folder: Path) -> tuple[Cameras, tuple[Calibration, ...]] | None:
    """The photos of a model with their poses in the scene and lenses; None without the files."""
    pairs = [(folder / f"images{suffix}", folder / f"cameras{suffix}") for suffix in _SUFFIXES]
    pair = next((p for p in pairs if all(file.is_file() for file in p)), None)
    if pair is None:
        return None
    images, lenses = pair
    binary = images.suffix == ".bin"
    try:
        known = (_binary_lenses if binary else _text_lenses)(lenses.read_bytes())
        found = sorted((_binary_images if binary else _text_images)(images.read_bytes()))
        missing = next((lens for *_, lens, _ in found if lens not in known), None)
        if missing is not None:
            raise _damaged(lenses, f"camera {missing} is missing")
        calibrations = tuple(calibration(name, *known[lens]) for *_, lens, name in found)
    except (ValueError, KeyError, IndexError, struct.error) as error:
        raise _damaged(images, f"{type(error).__name__}: {error}") from None
    if not found:
        return None
    wxyz = np.array([quaternion for _, quaternion, _, _, _ in found])
    moves = np.array([t for _, _, t, _, _ in found])
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(wxyz, axis=1)
    if not ((norms > _LEAST_NORM) & (norms < 1 / _LEAST_NORM)).all():  # NaN is neither
        raise _damaged(images, "a rotation is no rotation")
    if not np.isfinite(moves).all():
        raise _damaged(images, "a place is not finite")
    rotations = Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]).as_matrix()
    positions, quaternions = camera_poses(rotations, moves)
    return Cameras(positions, quaternions, tuple(name for *_, name in found)), calibrations


def _photo_folder(model: Path, name: str) -> Path | None:
    """Where COLMAP has the photos of a model: ``images`` beside it, or beside its ``sparse``."""
    places = (folder / "images" for folder in (model, model.parent, model.parent.parent))
    return next((folder for folder in places if (folder / name).is_file()), None)


_Image = tuple[int, tuple[float, ...], tuple[float, ...], int, str]
"""Id, quaternion wxyz and translation scene -> camera, id of the camera, name."""


def _binary_images(data: bytes) -> list[_Image]:
    (count,) = struct.unpack_from("<Q", data)
    at = 8
    images: list[_Image] = []
    for _ in range(_possible(count, len(data), 73)):
        key, *pose, lens = struct.unpack_from("<I7dI", data, at)
        end = data.index(b"\0", at + 64)
        name = data[at + 64 : end].decode("utf-8", "replace")
        (observations,) = struct.unpack_from("<Q", data, end + 1)
        at = end + 9 + _possible(observations, len(data) - end, 24) * 24
        images.append((key, tuple(pose[:4]), tuple(pose[4:]), lens, name))
    return images


def _text_images(data: bytes) -> list[_Image]:
    lines = [line for line in data.decode("utf-8", "replace").split("\n") if line[:1] != "#"]
    images: list[_Image] = []
    for line in lines[::2]:  # every other line lists what the photo saw, and may be empty
        words = line.split(maxsplit=9)
        if words:
            pose = tuple(map(float, words[1:8]))
            images.append((int(words[0]), pose[:4], pose[4:], int(words[8]), words[9].strip()))
    return images


_Lens = tuple[str, tuple[int, int], tuple[float, ...]]
"""Camera model, width and height, parameters."""


def _binary_lenses(data: bytes) -> dict[int, _Lens]:
    (count,) = struct.unpack_from("<Q", data)
    at = 8
    lenses: dict[int, _Lens] = {}
    for _ in range(_possible(count, len(data), 24)):
        key, model, *size = struct.unpack_from("<IiQQ", data, at)
        name, length = MODELS[model]
        lenses[key] = name, (size[0], size[1]), struct.unpack_from(f"<{length}d", data, at + 24)
        at += 24 + 8 * length
    return lenses


def _text_lenses(data: bytes) -> dict[int, _Lens]:
    rows = [line.split() for line in data.decode("utf-8", "replace").splitlines()]
    return {
        int(key): (name, (int(width), int(height)), tuple(map(float, params)))
        for key, name, width, height, *params in (r for r in rows if r and r[0][0] != "#")
    }


def _possible(count: int, room: int, least: int) -> int:
    """A number of things that each take at least so many bytes."""
    if count * least > room:
        raise ValueError(f"{count:,} entries do not fit into {room:,} bytes")
    return count


def points_file(folder: Path) -> Path:
    """The points3D file of a model.

    Raises
    ------
    StageError
        When the folder holds none; the message names the folders below it that do.
    """
    for name in ("points3D.bin", "points3D.txt"):
        if (folder / name).is_file():
            return folder / name
    below = sorted({p.parent for p in folder.rglob("points3D.*") if p.suffix in (".bin", ".txt")})
    if below:
        found = " or ".join(f"'{path.relative_to(folder)}'" for path in below)
        raise StageError(f"{folder}: not itself a COLMAP model; give the folder {found} below it")
    raise StageError(
        f"{folder}: no COLMAP model (no points3D.bin or points3D.txt); give a cloud or a model"
    )


def _damaged(path: Path, what: str) -> StageError:
    return StageError(f"{path}: cannot read the COLMAP model ({what}); copy or export it again")
