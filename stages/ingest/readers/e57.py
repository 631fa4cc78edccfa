"""E57 files of laser scanners [ASTM E2807]: several scans, each with its pose, in metres.

Read by pye57, which wraps libE57Format; it is an extra.
"""

# pye57 has no types
# pyright: reportMissingImports=false, reportMissingTypeStubs=false, reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from spinpipe.schemas.arrays import F64
from spinpipe.stages.ingest.readers.coordinates import Coordinates, beside, from_crs, parse_crs
from spinpipe.stages.ingest.readers.guarded import MOST_POINTS, guarded, readable
from spinpipe.stages.ingest.readers.point_fields import full_colour, to_8_bit
from spinpipe.stages.ingest.readers.scene_source import About, Chunk, white
from spinpipe.stages.stage import StageError

_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_INVALID = ("cartesianInvalidState", "sphericalInvalidState")
"""0: the point has coordinates; 1: only a direction; 2: nothing [ASTM E2807, 8.4.4]."""
_METRES = Coordinates(name="metres", metres=(1.0, 1.0, 1.0), source="the E57 standard")
_COLOURS = ("colorRed", "colorGreen", "colorBlue")


class E57Source:
    """The points of all scans of an E57 file, in the file's common frame.

    Raises
    ------
    StageError
        When pye57 is not installed, or the file cannot be read or has no scans.
    """

    def __init__(self, path: Path) -> None:
        try:
            import pye57  # noqa: F401  # pyright: ignore[reportUnusedImport]
        except ImportError:
            raise StageError(
                f"{path}: E57 files are read by pye57, which is not installed: "
                "pip install 'spinpipe[e57]'"
            ) from None
        self._path = path
        header = next(guarded(_header, path))
        self.points, self.coloured = header.points, header.coloured
        self._full = header.full
        crs = parse_crs(header.system) if header.system else None
        told = from_crs(crs, "E57 header") if crs else beside(path) or _METRES
        self.about = About(
            kind=f"E57, {header.scans} scan{'s' if header.scans > 1 else ''}",
            fields=header.fields,
            # lengths are metres by the standard, whatever the system has
            coordinates=replace(told, metres=(1.0, 1.0, 1.0), degrees=False),
        )
        if not header.scans:
            raise StageError(f"{path}: the E57 file has no scans; export the cloud again")

    def chunks(self, points: int) -> Iterator[Chunk]:
        """Points scan by scan, at most ``points`` at a time; those without coordinates are NaN."""
        if self.coloured and self._full is None:
            self._full = full_colour(rgb for _, rgb in self._pieces(points) if rgb is not None)
        for xyz, rgb in self._pieces(points):
            if rgb is None or self._full is None:
                yield xyz, white(len(xyz))
            else:
                yield xyz, to_8_bit(rgb, self._full)

    def _pieces(self, points: int) -> Iterator[tuple[F64, F64 | None]]:
        yield from guarded(_points, self._path, min(points, MOST_POINTS))


@dataclass(frozen=True)
class _Header:
    scans: int
    points: int
    coloured: bool
    full: float | None
    """Value of a channel at full brightness, where the file tells."""
    fields: tuple[str, ...]
    system: str


def _header(path: Path) -> Iterator[_Header]:
    with _opened(path) as (root, _):
        scans = _scans(root)
        fields = [_fields(scan) for scan in scans]
        system = root["coordinateMetadata"].value() if root.isDefined("coordinateMetadata") else ""
        shown = {*_CARTESIAN, *_SPHERICAL, *_INVALID, *_COLOURS}
        limits = [scan["colorLimits"] for scan in scans if scan.isDefined("colorLimits")]
        yield _Header(
            scans=len(scans),
            points=sum(scan["points"].childCount() for scan in scans),
            coloured=any(set(_COLOURS) <= set(names) for names in fields),
            full=max((float(limit["colorRedMaximum"].value()) for limit in limits), default=None),
            fields=tuple(dict.fromkeys(n for names in fields for n in names if n not in shown)),
            system=system,
        )


def _points(path: Path, points: int) -> Iterator[tuple[F64, F64 | None]]:
    """Coordinates (N, 3) in the common frame and colours (N, 3) as they are, piece by piece."""
    from pye57 import libe57

    with _opened(path) as (root, image):
        for scan in _scans(root):
            names = _fields(scan)
            axes = _CARTESIAN if set(_CARTESIAN) <= set(names) else _SPHERICAL
            if not set(axes) <= set(names):
                raise ValueError(f"a scan has no coordinates (only {', '.join(names)})")
            colours = _COLOURS if set(_COLOURS) <= set(names) else ()
            wanted = [*axes, *colours, *(name for name in _INVALID if name in names)]
            total = scan["points"].childCount()
            columns = {name: np.empty(min(points, max(total, 1))) for name in wanted}
            buffers = libe57.VectorSourceDestBuffer()
            for name, column in columns.items():
                buffers.append(
                    libe57.SourceDestBuffer(image, name, column, len(column), True, True)
                )
            reader = scan["points"].reader(buffers)
            R, t = _pose(scan)
            found = 0
            while count := reader.read():
                found += count
                x, y, z = (columns[name][:count] for name in axes)
                if axes is _SPHERICAL:  # range, azimuth, elevation [ASTM E2807, 5.3]
                    x, y, z = x * np.cos(z) * np.cos(y), x * np.cos(z) * np.sin(y), x * np.sin(z)
                xyz = np.stack([x, y, z], axis=1) @ R.T + t
                for name in set(_INVALID) & set(wanted):
                    xyz[columns[name][:count] != 0] = np.nan
                rgb = np.stack([columns[n][:count] for n in colours], axis=1) if colours else None
                yield xyz, rgb
            reader.close()
            if found < total:
                raise ValueError(f"{total - found:,} of {total:,} points of a scan are missing")


def _scans(root: Any) -> list[Any]:
    if not root.isDefined("data3D"):
        return []
    return [root["data3D"][i] for i in range(root["data3D"].childCount())]


def _fields(scan: Any) -> list[str]:
    from pye57 import libe57

    prototype = libe57.StructureNode(scan["points"].prototype())
    return [prototype.get(i).elementName() for i in range(prototype.childCount())]


def _pose(scan: Any) -> tuple[F64, F64]:
    """Rotation (3, 3) and translation (3,) scan -> file; none where it has none."""
    turn, move = Rotation.identity(), np.zeros(3)
    pose = scan["pose"] if scan.isDefined("pose") else None
    if pose is not None and pose.isDefined("rotation"):
        turn = Rotation.from_quat([pose["rotation"][name].value() for name in "xyzw"])
    if pose is not None and pose.isDefined("translation"):
        move = np.array([pose["translation"][axis].value() for axis in "xyz"])
    return turn.as_matrix(), move


@contextmanager
def _opened(path: Path) -> Generator[tuple[Any, Any]]:
    """Root node and file."""
    from pye57 import libe57

    with readable(path, "E57 file"):
        image = libe57.ImageFile(str(path), "r")
        try:
            yield image.root(), image
        finally:
            image.close()
