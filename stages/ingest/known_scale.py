"""How long a unit of the scene is by what is known: a distance, or where photos were taken."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.poses import Cameras
from spinpipe.schemas.records import Vector
from spinpipe.stages.stage import Section, StageError

_FEWEST = 4
"""Photos with GPS: three determine a similarity, one more shows whether they agree."""
_MOST_ERROR = 0.05
"""Standard error of the scale, relative, up to which it is taken: a car's length in a car's width
of doubt would hide which of two car models it is."""
_ASTRAY = 3.0
"""Photos whose GPS is off by so many median errors do not count."""
_ROUNDS = 20
_GPS = 0x8825
_LATITUDE, _LONGITUDE, _ALTITUDE = 2, 4, 6
"""Tags of the GPS directory, each behind its reference [CIPA DC-008, 4.6.6]."""


class ScaleFrom(Section):
    """What tells the scale where ingest.scale does not."""

    points: tuple[Vector, Vector] | None = Field(
        default=None, description="two points of the scene, [[x, y, z], [x, y, z]] in its units"
    )
    cameras: tuple[str, str] | None = Field(
        default=None, description="or two cameras, by the names of their photos"
    )
    distance_m: float | None = Field(
        default=None, ge=1e-6, le=1e7, description="how far the two are apart, metres"
    )
    gps: bool = Field(
        default=False, description="or the GPS in the photos of the cameras; needs ingest.photos"
    )

    @model_validator(mode="after")
    def _one_way(self) -> ScaleFrom:
        ways = sum((self.points is not None, self.cameras is not None, self.gps))
        if ways > 1:
            raise ValueError("give one of points, cameras and gps")
        pair = self.points is not None or self.cameras is not None
        if pair != (self.distance_m is not None):
            raise ValueError("a known distance needs distance_m, and points or cameras")
        return self

    @property
    def given(self) -> bool:
        """Whether it tells anything."""
        return self.gps or self.distance_m is not None


class KnownScale(NamedTuple):
    """A scale and where it comes from."""

    scale: float
    """Metres a unit."""
    note: str


def known_scale(
    rules: ScaleFrom, cameras: Cameras | None, photos: Path | None, where: Path
) -> KnownScale:
    """The scale by ``rules``, which must be ``given``.

    Parameters
    ----------
    rules : what is known.
    cameras : of the scene, in its units.
    photos : folder of the photos that these are named after.
    where : the scene, for messages.

    Raises
    ------
    StageError
        When there are no such cameras or photos, the two are in one place, or GPS is too inexact.
    """
    if rules.points is not None:
        first, second = np.array(rules.points)
        return _by_distance(first, second, rules.distance_m or 0, "two points", where)
    if cameras is None:
        raise StageError(
            f"{where}: [ingest.scale_from] asks for cameras, but the scene has none: give a COLMAP "
            "model, or two points and their distance"
        )
    if rules.cameras is not None:
        first, second = (cameras.positions[_row(cameras, name, where)] for name in rules.cameras)
        what = " and ".join(rules.cameras)
        return _by_distance(first, second, rules.distance_m or 0, what, where)
    if photos is None:
        raise StageError(f"{where}: [ingest.scale_from] gps needs the folder: [ingest] photos")
    return _by_gps(cameras, photos)


def _by_distance(first: F64, second: F64, metres: float, what: str, where: Path) -> KnownScale:
    units = float(np.linalg.norm(second - first))
    if not units > 0:
        raise StageError(f"{where}: [ingest.scale_from]: {what} are in one place")
    scale = metres / units
    return KnownScale(scale, f"{scale:.6g} m a unit: {what} are {metres:g} m apart")


def _row(cameras: Cameras, name: str, where: Path) -> int:
    """Of the camera with that name, or whose photo is called so in whatever folder."""
    found = [i for i, known in enumerate(cameras.names) if known == name]
    found = found or [i for i, known in enumerate(cameras.names) if Path(known).name == name]
    if len(found) == 1:
        return found[0]
    if found:
        raise StageError(f"{where}: {len(found)} cameras are called '{name}': name the folder too")
    near = difflib.get_close_matches(name, cameras.names, n=1, cutoff=0.0)
    raise StageError(f"{where}: no camera '{name}'; did you mean '{near[0]}'?")


def _by_gps(cameras: Cameras, photos: Path) -> KnownScale:
    """Fit the cameras to their GPS by a similarity [Umeyama 1991], without those far off."""
    from trimesh.registration import procrustes

    known = [(i, gps_of(photos / name)) for i, name in enumerate(cameras.names)]
    rows = [i for i, place in known if place is not None]
    if len(rows) < _FEWEST:
        raise StageError(
            f"{photos}: {len(rows)} of {len(cameras.names)} photos are there and have GPS, "
            f"{_FEWEST} are needed; use a known distance"
        )
    scene = cameras.positions[rows]
    earth = earth_centred([place for _, place in known if place is not None])
    middle = earth.mean(axis=0)  # millions of metres would cost digits
    kept = np.ones(len(rows), np.bool_)
    errors = np.zeros(len(rows))
    T_earth_scene: F64 = np.eye(4)
    for _ in range(_ROUNDS):
        T_earth_scene = np.asarray(
            procrustes(scene[kept], (earth - middle)[kept], reflection=False, return_cost=False)
        )
        placed = scene @ T_earth_scene[:3, :3].T + T_earth_scene[:3, 3]
        errors = np.linalg.norm(placed - (earth - middle), axis=1)
        before, kept = kept, errors <= max(_ASTRAY * float(np.median(errors)), 1e-9)
        if (kept == before).all() or kept.sum() < _FEWEST:
            break
    scale = float(np.cbrt(np.linalg.det(T_earth_scene[:3, :3])))
    used = scene[kept] - scene[kept].mean(axis=0)
    # of the least squares: each coordinate's variance by 7 parameters' loss, over the spread
    freedom = 3 * int(kept.sum()) - 7
    spread = scale * float(np.linalg.norm(used))
    error = float(np.sqrt((errors[kept] ** 2).sum() / freedom)) / spread if spread > 0 else np.inf
    rms_m = float(np.sqrt((errors[kept] ** 2).mean()))
    said = f"GPS of {int(kept.sum())} of {len(cameras.names)} photos, which is off by {rms_m:.2g} m"
    if not error <= _MOST_ERROR:
        raise StageError(
            f"{photos}: the scale by {said} is uncertain by {error:.0%}: the photos were taken too "
            "close together; use a known distance"
        )
    return KnownScale(scale, f"{scale:.6g} m a unit (± {error:.2%}) by {said}")


def gps_says(cameras: Cameras, photos: Path) -> str:
    """What the GPS of photos says where a unit is taken for a metre; empty where it says nothing.

    A model that was aligned to GPS about its first photo looks like one that never was.
    """
    try:
        found = known_scale(ScaleFrom(gps=True), cameras, photos, photos)
    except StageError:
        return ""
    if abs(found.scale - 1) < _MOST_ERROR:
        return f"a unit is a metre, as the photos say: {found.note}"
    return (
        f"odd: a unit is taken for a metre, but the photos say {found.note}; set "
        f"[ingest.scale_from] gps = true and [ingest] photos = '{photos}'"
    )


def gps_of(photo: Path) -> Vector | None:
    """Longitude and latitude in degrees and height in metres by EXIF; None where it has none."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(photo) as image:
            tags: dict[int, Any] = dict(image.getexif().get_ifd(_GPS))
        longitude = _degrees(tags[_LONGITUDE]) * (-1 if _letter(tags[_LONGITUDE - 1]) == "W" else 1)
        latitude = _degrees(tags[_LATITUDE]) * (-1 if _letter(tags[_LATITUDE - 1]) == "S" else 1)
        below = tags.get(_ALTITUDE - 1) in (1, b"\x01")
        height = float(tags.get(_ALTITUDE, 0)) * (-1 if below else 1)
    except (OSError, UnidentifiedImageError, KeyError, TypeError, ValueError, ZeroDivisionError):
        return None
    place = (longitude, latitude, height)
    return place if np.isfinite(place).all() and any(place[:2]) else None


def _degrees(parts: Sequence[Any]) -> float:
    degrees, minutes, seconds = (float(part) for part in parts)
    return degrees + minutes / 60 + seconds / 3600


def _letter(reference: Any) -> str:
    return str(reference).strip("\0 ").upper()[:1]


def earth_centred(places: Sequence[Vector]) -> F64:
    """Longitude, latitude and height on WGS 84 -> earth-centred metres (N, 3)."""
    from pyproj import Transformer

    to_earth = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    return np.stack(to_earth.transform(*np.array(places).T), axis=1)
