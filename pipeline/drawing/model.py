"""An object model as a Rerun shape: its mesh where it has one, else its points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.drawing import Reader, at_stage, note
from spinpipe.pipeline.drawing.palette import Colour
from spinpipe.schemas import MODELS
from spinpipe.schemas.arrays import F64, U8
from spinpipe.schemas.records import ObjectModel

_POINTS_SHOWN = 5000


def draw(read: Reader, rec: rr.RecordingStream, preview_points: int) -> None:  # noqa: ARG001
    """Models side by side along y; on each the points of the part that the sensor could see."""
    models = read(MODELS)
    at_stage(rec, "model")
    for model, y in zip(models, places_in_row(models), strict=True):
        path, (low, high) = model_path("model/objects", model.name), model_bounds(model)
        rec.log(path, rr.Transform3D(translation=[0, y, 0]), static=True)
        rec.log(f"{path}/shape", model_shape(model, palette.PALE), static=True)
        rec.log(f"{path}/points", model_points(model, palette.MARK), static=True)
        label = rr.Points3D([[low[0], 0, high[2]]], labels=model.name, radii=-1.0)
        rec.log(f"{path}/name", label, static=True)
    note(rec, _summary(models))


def _summary(models: Sequence[ObjectModel]) -> str:
    lines = [
        "## Model: what is looked for",
        "",
        "| model | length m | width m | height m | points | visible from |",
        "|---|---|---|---|---|---|",
    ]
    for model in models:
        length, width, height = np.diff(model_bounds(model), axis=0)[0]
        lines.append(
            f"| {model.name} | {length:.2f} | {width:.2f} | {height:.2f} "
            f"| {len(model.points):,} | {model.visible_from} |"
        )
    return "\n".join(lines)


def model_shape(model: ObjectModel, color: Colour | None = None) -> rr.Mesh3D | rr.Points3D:
    """Mesh with flat faces, or thinned points, in the object frame; ``None`` colours it later."""
    if not len(model.faces):
        return model_points(model, color)
    corners = model.vertices[model.faces].astype(np.float32)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3),
        vertex_normals=np.repeat(normals, 3, axis=0),
        albedo_factor=color,
    )


def model_tint(model: ObjectModel, color: Colour) -> rr.Mesh3D | rr.Points3D:
    """Only the colour of ``model_shape``, to change it over time."""
    if not len(model.faces):
        return rr.Points3D.from_fields(colors=[color])
    return rr.Mesh3D.from_fields(albedo_factor=color)


def model_tints(model: ObjectModel, colors: U8) -> rr.ComponentColumnList:
    """(N, 4) colours of ``model_shape``, one a row."""
    if not len(model.faces):
        return rr.Points3D.columns(colors=colors)
    return rr.Mesh3D.columns(albedo_factor=colors)


def model_points(model: ObjectModel, color: Colour | None) -> rr.Points3D:
    """At most a few thousand of the model's points, in the object frame."""
    step = -(-len(model.points) // _POINTS_SHOWN)
    return rr.Points3D(model.points[:: max(step, 1)], colors=color, radii=-1.2)


def model_bounds(model: ObjectModel) -> F64:
    """(2, 3) lowest and highest coordinates in the object frame, metres."""
    points = model.points if len(model.points) else model.vertices
    return np.stack([points.min(axis=0), points.max(axis=0)]).astype(np.float64)


def places_in_row(models: Sequence[ObjectModel]) -> F64:
    """(N,) where along y to put each model so that they stand side by side around the origin."""
    widths = np.array([1.4 * np.ptp(model_bounds(model)[:, 1]) for model in models])
    return np.cumsum(widths) - widths / 2 - widths.sum() / 2


def model_path(root: str, model: str) -> str:
    """Entity of one model under ``root``."""
    return f"{root}/{rr.escape_entity_path_part(model)}"


def pose_of(T_world_object: F64) -> rr.InstancePoses3D:
    """Place a shape by one (4, 4) or many (N, 4, 4) transforms, stretch included."""
    T = np.asarray(T_world_object, np.float32).reshape(-1, 4, 4)
    return rr.InstancePoses3D(translations=T[:, :3, 3], mat3x3=T[:, :3, :3])


def hidden() -> rr.InstancePoses3D:
    """Place a shape nowhere: an empty list of poses would draw it once, at the origin."""
    return rr.InstancePoses3D(translations=np.zeros((1, 3)), mat3x3=np.zeros((1, 3, 3)))
