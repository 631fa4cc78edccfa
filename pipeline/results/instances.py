"""Detections as plain rows: every number with its frame and unit in its name."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeVar

import numpy as np

from spinpipe.schemas.arrays import F64, I32
from spinpipe.schemas.records import Detection, ObjectModel
from spinpipe.schemas.topics import Topic
from spinpipe.stages.geometry.frames import inverse, rotation_quaternion

T = TypeVar("T")

_STEEP = 0.996
"""Sine of the elevation (85 degrees) from which on a direction has no heading in the x-y plane."""


class ReadTopic(Protocol):
    """Reads any topic of a run."""

    def __call__(self, topic: Topic[T]) -> Sequence[T]:
        """Records of a topic."""
        ...


def T_scene_object(d: Detection, models: Mapping[str, ObjectModel]) -> F64:
    """(4, 4) from the upright object in metres, stretch included, to scene coordinates."""
    return d.T_scene_model @ inverse(models[d.model].T_object_model)


def heading_scene_deg(T: F64) -> float:
    """Direction of the object's +x in the scene's x-y plane, degrees from +x to +y, in [0, 360).

    NaN where it points along the scene's z: a scene that is not upright.
    """
    x, y, z = T[:3, 0] / np.linalg.norm(T[:3, 0])
    return float("nan") if abs(z) > _STEEP else float(np.degrees(np.arctan2(y, x)) % 360.0)


def box_corners(d: Detection, T: F64) -> F64:
    """(8, 3) corners of the fitted box in the frame that ``T`` (4, 4) leads to.

    Base first, counter-clockwise from ahead on the left, then the top in the same order. ``T`` maps
    from the object and holds the stretch, as ``Detection.T_world_object`` does.
    """
    stretch = np.linalg.norm(d.T_world_object[:3, :3], axis=0)
    half = np.asarray(d.size_m) / np.where(stretch > 0, stretch, 1.0) * (0.5, 0.5, 1.0)
    square = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], np.float64)
    corners = np.array([[*xy, z] for z in (0.0, 1.0) for xy in square]) * half
    return corners @ T[:3, :3].T + T[:3, 3]


def row(d: Detection, models: Mapping[str, ObjectModel]) -> dict[str, Any]:
    """One detection as a flat row, for tables: strings and finite or not finite numbers."""
    T = T_scene_object(d, models)
    values: dict[str, Any] = {"id": d.id, "model": d.model, "fate": d.fate}
    for frame, place in (("scene", d.position_scene), ("world", d.position_world)):
        values |= {f"{axis}_{frame}": v for axis, v in zip("xyz", place, strict=True)}
    values["heading_scene_deg"] = heading_scene_deg(T)
    values["heading_world_deg"] = d.heading_deg
    values |= dict(zip(("length_m", "width_m", "height_m"), d.size_m, strict=True))
    for name in ("score", "rms_m", "coverage_model", "coverage_scene", "heading_margin"):
        values[name] = getattr(d, name)
    return values


ROW_COLUMNS = (
    *("id", "model", "fate", "x_scene", "y_scene", "z_scene", "x_world", "y_world", "z_world"),
    *("heading_scene_deg", "heading_world_deg", "length_m", "width_m", "height_m", "score"),
    *("rms_m", "coverage_model", "coverage_scene", "heading_margin"),
)
"""Names of ``row``, in its order."""

_RENAMED = {"runner_up_heading_deg", "runner_up_rms_m", "T_world_object", "parts"}


def entry(d: Detection, models: Mapping[str, ObjectModel]) -> dict[str, Any]:
    """One detection for detections.json: all its fields; a number that does not exist is null."""
    values: dict[str, Any] = {
        field.name: getattr(d, field.name)
        for field in dataclasses.fields(d)
        if field.name not in _RENAMED
    }
    values["heading_scene_deg"] = heading_scene_deg(T_scene_object(d, models))
    values["quaternion_xyzw"] = tuple(rotation_quaternion(d.T_world_object).tolist())
    values["parts"] = {part.name: part.value for part in d.parts}
    if d.parts:
        values["evidence"] = d.parts
    values["runner_up"] = {"heading_deg": d.runner_up_heading_deg, "rms_m": d.runner_up_rms_m}
    return {name: plain(value) for name, value in values.items()}


def plain(value: Any) -> Any:
    """As JSON knows it: no arrays, no records, null for numbers that are not finite."""
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain({f.name: getattr(value, f.name) for f in dataclasses.fields(value)})
    return value


def mesh_of(d: Detection, models: Mapping[str, ObjectModel]) -> tuple[F64, I32]:
    """Vertices (V, 3) in scene coordinates and faces (F, 3) of a fitted model.

    A model that is a cloud gives its points and no faces.
    """
    model, T = models[d.model], T_scene_object(d, models)
    local = model.vertices if len(model.faces) else model.points
    return local.astype(np.float64) @ T[:3, :3].T + T[:3, 3], model.faces
