"""Whether scene and models can be what they seem: units, steps of the coordinates, sizes.

What cannot be right stops the run, what is odd becomes a line that names the key to try.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import ObjectModel, SceneFrame, Vector
from spinpipe.stages.ingest.model_file import ModelFile
from spinpipe.stages.ingest.readers.coordinates import Coordinates, place_of
from spinpipe.stages.ingest.readers.scene_source import SceneSource
from spinpipe.stages.ingest.survey import Survey, kept_box, within
from spinpipe.stages.stage import StageError

UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "feet": 0.3048}
"""Units that scenes and models come in when not in metres."""

_CAR = re.compile(r"car|auto|saloon|sedan|hatch|estate|suv|coupe|taxi|pickup|beetle", re.I)
_CAR_M, _CAR_LENGTH_M = 4.5, (2.2, 7.0)
"""A usual one; from a microcar to the longest pickup."""
_MOST_SPACING = 0.5
"""Points farther apart than this share of a model's longest side cannot show its shape."""
_ODD_SPACING = 0.1
_FINE_SPACING = 0.002
_COARSEST = 0.2
"""Steps, in the height of a model, in which its shape is lost."""
_COARSE = 0.5
"""Steps of the coordinates, in spacings, that are coarser than the surface is sampled."""
_SHEET_HEIGHT = 0.05
"""Lowest part of a model, in its height, in which a sheet of ground would lie."""
_SHEET_WIDER = 1.6
"""A sheet reaches this much farther than what stands on it."""
_STRETCHED = 0.01
"""UTM and other grids for surveyors stay far below."""
_SCALES, _WIDEST_M = (1e-9, 1e9), 1e8
"""As the config allows, and several times as wide as the Earth."""
_NO_LENGTH = 1e18
"""Nanometres to the Sun stay below."""
_LON_LAT = (180.0, 90.0)
_DEGREES_ACROSS = 1.0
_DEGREES_RATIO = 1000.0
"""A degree is about 1e5 m: heights in metres over degrees are never below this."""
_MOST_OF_SCENE = 0.5
"""Of a scene's longest side: what is searched is much smaller, though one may stand alone."""
_FINER = "export them as double, with an offset, or (LAS) with a finer scale"


def believable(told: Coordinates, low: F64, high: F64) -> tuple[Coordinates, str]:
    """What the file says of its coordinates, unless they cannot be that; a note if so."""
    most = np.abs([low, high])[:, :2].max(axis=0)
    if not told.degrees or (most <= _LON_LAT).all():
        return told, ""
    return Coordinates(), (
        f"odd: {told.source} says degrees ({told.name}), but x reaches {most[0]:.6g} and y "
        f"{most[1]:.6g}: taken for metres; if they are not, set [ingest] scale"
    )


def on_the_ground(told: Coordinates, low: F64, high: F64) -> tuple[Coordinates, str]:
    """Metres on the ground where a projection stretches them by over 1 %; a note if so.

    Mercator's metres, those of web maps, are too short by the cosine of the latitude.
    """
    if not told.crs or told.degrees or told.geocentric or told.metres is None:
        return told, ""
    place = place_of(told.crs, *((low + high) / 2)[:2].tolist())
    if place is None or not place.in_use:
        return told, (
            f"odd: x and y lie outside the area of {told.name} ({told.source}); if they are in "
            "another unit, state [ingest] scale"
        )
    x, y = place.stretch
    if max(abs(x - 1), abs(y - 1)) < _STRETCHED:
        return told, ""
    if abs(x / y - 1) < _STRETCHED:
        x = y = float(np.sqrt(x * y))
    metres = (told.metres[0] / x, told.metres[1] / y, told.metres[2])
    return replace(told, metres=metres), (
        f"{told.name} draws the ground there {_numbers((x, y))} times as large; where that is "
        "wrong, state [ingest] scale"
    )


def scale_of(stated: float | Vector | None, coordinates: Coordinates, where: Path) -> Vector:
    """Metres a unit of the scene along x, y and z.

    Parameters
    ----------
    stated : ``ingest.scale``; None: as the file says, else 1.
    coordinates : what the file says.
    where : the file, for messages.

    Raises
    ------
    StageError
        When x and y are degrees.
    """
    if coordinates.degrees and stated is None:
        raise _degrees(where, f"{coordinates.name or 'longitude and latitude'}, "
                              f"from {coordinates.source}")  # fmt: skip
    if isinstance(stated, tuple):
        return stated
    if stated is not None:
        return (stated, stated, stated)
    return coordinates.metres or (1.0, 1.0, 1.0)


def require_on_earth(found: Survey, scale: Vector, where: Path) -> None:
    """Stop where the units or the scene cannot be real: its metres would not fit float32.

    Raises
    ------
    StageError
    """
    most = float(np.abs([found.low, found.high]).max())
    if most > _NO_LENGTH:
        raise StageError(
            f"{where}: its coordinates reach {most:.2g}, which no length does: its number type or "
            "byte order may be another than its header says; export the file again"
        )
    width_m = float(((found.high - found.low) * scale).max())
    if not all(_SCALES[0] <= metres <= _SCALES[1] for metres in scale) or width_m > _WIDEST_M:
        raise StageError(
            f"{where}: is {width_m:.3g} m wide with a scale of {_numbers(scale)} m a unit: correct "
            "[ingest] scale, or what [ingest.scale_from] tells; or export the file again"
        )


def scale_note(stated: float | Vector | None, coordinates: Coordinates) -> str:
    """What is done about the unit; empty where it is the metre or nobody said."""
    told = coordinates.metres
    if stated is not None:
        given = stated if isinstance(stated, tuple) else (stated,) * 3
        if told is not None and not np.allclose(given, told, rtol=1e-3):
            return (
                f"[ingest] scale is {_numbers(given)}, though {coordinates.source} says "
                f"{_numbers(told)} m a unit ({coordinates.name})"
            )
        return ""
    if told is None or told == (1.0, 1.0, 1.0):
        return ""
    apart = "" if len(set(told)) == 1 else "; z has a unit of its own"
    return (
        f"coordinates are {coordinates.name} ({coordinates.source}): {_numbers(told)} m a unit"
        f"{apart}"
    )


def refuse_degrees(low: F64, high: F64, where: Path) -> None:
    """Stop where the coordinates, from ``low`` to ``high`` (3,), look like degrees unsaid.

    Raises
    ------
    StageError
    """
    reach = high - low
    across = float(reach[:2].max())
    lat_lon = np.abs([low, high])[:, :2].max(axis=0) <= _LON_LAT
    if 0 < across < _DEGREES_ACROSS and reach[2] > _DEGREES_RATIO * across and lat_lon.all():
        raise _degrees(where, f"x and y span {across:.2g}, z {reach[2]:.3g}")


def coarse_steps(found: Survey, scale: Vector, spacing_m: float) -> str:
    """What is odd about the steps of the coordinates; empty where they are fine enough."""
    steps_m = np.array(found.steps) * scale
    axis = int(np.argmax(steps_m))
    if not steps_m[axis] > _COARSE * spacing_m > 0:
        return ""
    most = np.float32(np.abs([found.low, found.high])[:, axis].max())
    floats = found.single_precision and found.steps[axis] < 2 * float(np.spacing(most))
    why = ", as 32-bit floats have there" if floats else ""
    return f"coordinates come in steps of {steps_m[axis]:.2g} m along {'xyz'[axis]}{why}: {_FINER}"


def require_possible(scene: SceneFrame, scene_m: float, model: ObjectModel) -> None:
    """Stop where the scene cannot show a model.

    Parameters
    ----------
    scene : its frame, with spacing and steps.
    scene_m : its longest side.
    model : what to look for in it.

    Raises
    ------
    StageError
        When the coordinates come in steps near the model's height, the points lie farther apart
        than half of it, or the whole scene is smaller than it.
    """
    longest, height = _longest(model), float(model.size[2])
    if scene.step_m > max(_COARSE * scene.spacing_m, _COARSEST * height):
        raise StageError(
            f"{scene.source}: coordinates come in steps of {scene.step_m:.2g} m, too coarse for "
            f"model '{model.name}', {height:.3g} m high: {_FINER}"
        )
    if longest > scene_m:
        raise StageError(
            f"model '{model.name}' is {longest:.3g} m long, the whole scene {scene_m:.3g} m; "
            f"correct [ingest] scale (now {_numbers(scene.scale)}) or the scale of that [[model]]"
            + _model_hint(longest, scene_m, scene.spacing_m)
        )
    if scene.spacing_m > _MOST_SPACING * longest:
        raise StageError(
            f"points lie {scene.spacing_m:.3g} m apart, model '{model.name}' is {longest:.3g} m "
            f"long: too sparse to show it, or [ingest] scale (now {_numbers(scene.scale)}) is wrong"
            + _spacing_hint(scene.spacing_m, longest)
        )


def odd_sampling(scene: SceneFrame, model: ObjectModel) -> str:
    """What may be right but is odd about the points of a scene, given a model; empty if nothing."""
    longest = _longest(model)
    if not scene.spacing_m > _ODD_SPACING * longest:
        return ""
    return (
        f"points lie {scene.spacing_m:.3g} m apart, model '{model.name}' is only "
        f"{longest:.3g} m long; if the scene is not in metres, set [ingest] scale"
    )


def odd_shape(model: ObjectModel) -> str:
    """What may be right but is odd about a model by itself; empty if nothing."""
    longest = _longest(model)
    if odd := _sheet(model) or _far_part(model):
        return odd
    if not _CAR.search(model.name) or _CAR_LENGTH_M[0] <= longest <= _CAR_LENGTH_M[1]:
        return ""
    return (
        f"model '{model.name}' is {longest:.3g} m long, {model.size[2]:.3g} m high: no car is"
        + _car_hint(longest)
    )


def _longest(model: ObjectModel) -> float:
    return float(max(model.size[:2]))


def scene_line(source: SceneSource, found: Survey, scale: Vector, spacing_m: float) -> str:
    """The scene in one line, as a run begins with it."""
    size = " x ".join(f"{side:.4g}" for side in (found.high - found.low) * scale)
    cameras = source.about.cameras
    parts = [
        f"{source.about.kind}: {found.points - found.strays:,} points, {size} m",
        f"{spacing_m:.2g} m apart",
        "coloured" if source.coloured else "",
        f"{len(cameras.positions)} cameras" if cameras else "",
    ]
    return ", ".join(part for part in parts if part)


def model_line(model: ObjectModel, file: ModelFile) -> str:
    """A model in one line."""
    size = " x ".join(f"{side:.3g}" for side in model.size)
    if file.faces is None:
        what = f"{len(file.corners):,} points"
    else:
        what = f"{len(file.faces):,} faces, {'' if file.closed else 'not '}closed"
    return (
        f"model {model.name}: {size} m (length, width, height), {what}; up is {file.up}, "
        f"{file.reason}"
        + (
            f"; {file.coordinates.source}: {file.metres:g} m a unit"
            if file.metres not in (None, 1.0)
            else ""
        )
    )


def _sheet(model: ObjectModel) -> str:
    """A backdrop below a model: what lies at its base reaches far beyond the rest."""
    points = model.vertices if len(model.vertices) else model.points
    high = points[:, 2] > _SHEET_HEIGHT * float(model.size[2])
    if not high.any() or high.all():
        return ""
    whole, above = model.size[:2], np.ptp(points[high][:, :2], axis=0)
    if not (whole > _SHEET_WIDER * above).all():
        return ""
    return (
        f"model '{model.name}' is {max(whole):.3g} m wide because of a sheet at its base, the rest "
        f"{above[0]:.3g} x {above[1]:.3g} m; remove the sheet from the model"
    )


def _far_part(model: ObjectModel) -> str:
    """Something far from the rest that makes a model look large."""
    points = (model.vertices if len(model.vertices) else model.points).astype(np.float64)
    rest = points[within(points, *kept_box(points))]
    size = np.ptp(rest, axis=0)
    if len(rest) == len(points) or 2 * size.max() > max(model.size):
        return ""
    return (
        f"model '{model.name}' is {max(model.size):.3g} m large because of a part far from the "
        f"rest, which is {size[0]:.3g} x {size[1]:.3g} x {size[2]:.3g} m; remove that part"
    )


def _degrees(where: Path, why: str) -> StageError:
    return StageError(
        f"{where}: x and y are degrees ({why}); reproject them to metres, for example "
        "with 'pdal translate --filter filters.reprojection' to the local UTM zone"
    )


def _car_hint(longest_m: float) -> str:
    """The unit in which a model would be as long as a car, if one is within a factor of two."""
    too_long = longest_m / _CAR_M
    if not too_long > 0:
        return ""
    name, metres = min(UNITS.items(), key=lambda unit: abs(np.log(unit[1] * too_long)))
    if abs(np.log(metres * too_long)) > np.log(2.2):
        return ""
    return f"; it may be in {name}: try [[model]] scale = {metres:g}"


def _model_hint(longest_m: float, scene_m: float, spacing_m: float) -> str:
    """Units of a model in which the scene's points would show it well."""
    fit = [
        f"{metres:g} for {name}"
        for name, metres in UNITS.items()
        if spacing_m / _ODD_SPACING < metres * longest_m < _MOST_OF_SCENE * scene_m
    ]
    return f"; try [[model]] scale = {' or '.join(fit)}" if fit else ""


def _spacing_hint(spacing_m: float, longest_m: float) -> str:
    """Units of the scene in which its points would show the model well."""
    fit = [
        f"{metres:g} for {name}"
        for name, metres in UNITS.items()
        if _FINE_SPACING * longest_m < metres * spacing_m < _ODD_SPACING * longest_m
    ]
    return f"; try [ingest] scale = {' or '.join(fit)}" if fit else ""


def _numbers(scale: Sequence[float]) -> str:
    return f"{scale[0]:g}" if len(set(scale)) == 1 else f"[{', '.join(f'{v:g}' for v in scale)}]"
