"""Units and coordinate systems: what a file's coordinates mean in metres.

A scene file may carry a coordinate reference system (LAS records, a comment in a PLY header, a
``.prj`` beside it), or only the name of a unit. PROJ, through pyproj, reads the former.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from spinpipe.schemas.records import Vector

if TYPE_CHECKING:
    from pyproj import CRS

_UNITS_M = {
    r"m|met(re|er)s?": 1.0,
    r"mm|millimet(re|er)s?": 1e-3,
    r"cm|centimet(re|er)s?": 1e-2,
    r"km|kilomet(re|er)s?": 1e3,
    r"us[-_ ]?(survey[-_ ]?)?(ft|foot|feet)|ftus": 1200 / 3937,
    r"ft|foot|feet|international[-_ ]foot": 0.3048,
    r"in|inch(es)?": 0.0254,
}
"""Names of units as exporters write them, in metres [NIST SP 811, appendix B]."""

_EAST_WEST_DEG, _NORTH_SOUTH_DEG = 15.0, 3.0
"""Beyond the area that a projection is meant for: Norway uses zone 33 of UTM all over."""


@dataclass(frozen=True)
class Coordinates:
    """What the numbers of a file are."""

    crs: str = ""
    """Authority and code (``EPSG:32615``), or WKT; empty where the file does not say."""
    name: str = ""
    """Of the system or unit, to be shown."""
    metres: Vector | None = None
    """Metres a unit along x, y and z; None where the file does not say."""
    degrees: bool = False
    """Whether x and y are longitude and latitude."""
    geocentric: bool = False
    """Whether x, y and z count from the middle of the Earth."""
    source: str = ""
    """What said so."""

    @property
    def z_is_height(self) -> bool:
        """Whether z is a height: the system is projected or geographic."""
        return bool(self.crs) and not self.geocentric


def from_crs(crs: CRS, source: str) -> Coordinates:
    """Units of a coordinate reference system; a height without a unit of its own has that of x."""
    axes = list(_axes(crs))
    horizontal = next((a for a in axes if not _vertical(a)), None)
    vertical = next((a for a in axes if _vertical(a)), horizontal)
    flat = float(horizontal.unit_conversion_factor) if horizontal else 1.0
    degrees = crs.is_geographic
    height = float(vertical.unit_conversion_factor) if vertical else 1.0
    if vertical is horizontal and degrees:
        height = 1.0
    authority = crs.to_authority()
    return Coordinates(
        crs=":".join(authority) if authority else crs.to_wkt(),
        name=crs.name,
        metres=(flat, flat, height),
        degrees=degrees,
        geocentric=crs.is_geocentric,
        source=source,
    )


def _axes(crs: CRS) -> Iterable[Any]:
    """Axes of a system and of its parts: a compound one lists its parts' only in them."""
    return crs.axis_info or [axis for part in crs.sub_crs_list for axis in part.axis_info]


def _vertical(axis: Any) -> bool:
    return axis.direction in ("up", "down")


def from_text(texts: Iterable[str], source: str) -> Coordinates | None:
    """Coordinate system or unit named in comments: ``EPSG:32633``, WKT, ``units: feet``."""
    unit = None
    for text in texts:
        found = re.search(r"\bEPSG\W{1,3}(\d{4,6})\b", text, re.I) or re.search(
            r"\b(?:PROJCS|PROJCRS|GEOGCS|GEOGCRS|GEOCCS|GEODCRS|COMPD_CS|COMPOUNDCRS)\[.*", text
        )
        if found:
            crs = parse_crs(f"EPSG:{found[1]}" if found.re.groups else found[0])
            if crs is not None:
                return from_crs(crs, source)
        named = re.search(r"\bunits?\b[\s:=\"']+([a-zA-Z][-_a-zA-Z ]*)", text, re.I)
        if named and unit is None:
            unit = from_unit(named[1].strip(), source)
    return unit


def from_unit(name: str, source: str) -> Coordinates | None:
    """A unit by its name; None where it is not known."""
    for pattern, metres in _UNITS_M.items():
        if re.fullmatch(pattern, name, re.I):
            return Coordinates(name=name, metres=(metres, metres, metres), source=source)
    return None


def beside(path: Path) -> Coordinates | None:
    """System of the ``.prj`` file that lies beside a scene's file under the same name."""
    for suffix in (".prj", ".PRJ"):
        prj = path.with_suffix(suffix)
        if prj.is_file():
            crs = parse_crs(prj.read_text("utf-8", "replace"))
            return from_crs(crs, prj.name) if crs else None
    return None


def parse_crs(text: str) -> CRS | None:
    """A coordinate reference system from any of its notations; None where it is none."""
    from pyproj import CRS  # heavy: only where needed
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(text.strip())
    except CRSError:
        return None


@dataclass(frozen=True)
class Place:
    """A point of a projection on the Earth."""

    stretch: tuple[float, float]
    """How much longer than the ground it is drawn, along x and y."""
    in_use: bool
    """Whether the projection is meant for there."""


def place_of(crs: str, x: float, y: float) -> Place | None:
    """Where a projection has a point; None where that is not known, or not on the Earth."""
    from pyproj import Proj, Transformer
    from pyproj.exceptions import ProjError

    system = parse_crs(crs)
    if system is None or system.geodetic_crs is None:
        return None
    try:
        to_degrees = Transformer.from_crs(system, system.geodetic_crs, always_xy=True)
        longitude, latitude = to_degrees.transform(x, y)
        factors = Proj(system).get_factors(longitude, latitude)
    except ProjError:
        return None
    stretch = (float(factors.parallel_scale), float(factors.meridional_scale))
    if not all(0 < factor < float("inf") for factor in stretch):
        return None
    use = system.area_of_use
    return Place(
        stretch,
        use is None
        or (
            use.south - _NORTH_SOUTH_DEG <= latitude <= use.north + _NORTH_SOUTH_DEG
            and (longitude - use.west + _EAST_WEST_DEG) % 360
            <= ((use.east - use.west) % 360 or 360) + 2 * _EAST_WEST_DEG
        ),
    )
