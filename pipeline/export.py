"""Results for people and other programs: detections.json, detections.csv, detections.ply."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from io import StringIO
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply
from spinpipe.schemas import DETECTIONS, MODELS
from spinpipe.schemas.records import Detection, ObjectModel
from spinpipe.schemas.topics import Topic
from spinpipe.stages.geometry.frames import inverse

T = TypeVar("T")

_COLUMNS = (
    *("id", "model", "x", "y", "z", "heading_deg", "score", "rms_m", "coverage_model"),
    *("coverage_scene", "heading_margin", "length_m", "width_m", "height_m"),
)

PALETTE = ((0, 158, 115), (0, 114, 178), (213, 94, 0), (204, 121, 167), (230, 159, 0))
"""Colours of models that colour-blind people can tell apart (Okabe and Ito)."""


class ReadTopic(Protocol):
    """Reads any topic of a run."""

    def __call__(self, topic: Topic[T]) -> Sequence[T]:
        """Records of a topic."""
        ...


def export_results(run: str, read: ReadTopic, folder: RunFolder) -> list[Detection]:
    """Write the three result files of a run and return all its detections."""
    detections = list(read(DETECTIONS))
    models = {model.name: model for model in read(MODELS)}
    accepted = [d for d in detections if d.fate == "accepted"]
    document = {"schema": 1, "run": run, "detections": [_entry(d) for d in detections]}
    text = json.dumps(document, indent=1, allow_nan=False) + "\n"
    write_atomically(folder.detections_json, lambda path: path.write_text(text, encoding="utf-8"))
    table = _csv(accepted)
    write_atomically(folder.detections_csv, lambda path: path.write_text(table, encoding="utf-8"))
    write_atomically(folder.detections_ply, lambda path: _write_ply(path, accepted, models))
    return detections


def _entry(d: Detection) -> dict[str, Any]:
    x, y, z, w = _heading_quaternion(d.heading_deg)
    entry: dict[str, Any] = {
        "id": d.id,
        "model": d.model,
        "fate": d.fate,
        "reason": d.reason,
        "position_world": list(d.position_world),
        "position_scene": list(d.position_scene),
        "heading_deg": d.heading_deg,
        "heading_margin": d.heading_margin,
        "quaternion_xyzw": [x, y, z, w],
        "T_scene_model": d.T_scene_model.tolist(),
        "correlation": d.correlation,
        "rms_m": d.rms_m,
        "inliers": d.inliers,
        "coverage_model": d.coverage_model,
        "coverage_scene": d.coverage_scene,
        "observed": d.observed,
        "score": d.score,
        "parts": {part.name: part.value for part in d.parts},
        "size_m": list(d.size_m),
        "runner_up": {"heading_deg": d.runner_up_heading_deg, "rms_m": d.runner_up_rms_m},
        "alternative": d.alternative,
        "alternative_margin": d.alternative_margin,
        "cluster": d.cluster,
    }
    return {key: _finite(value) for key, value in entry.items()}


def _heading_quaternion(heading_deg: float) -> tuple[float, float, float, float]:
    """Rotation object -> world of an upright object."""
    half = np.radians(heading_deg) / 2
    return 0.0, 0.0, float(np.sin(half)), float(np.cos(half))


def _finite(value: Any) -> Any:
    """JSON has no infinity and no NaN: a number that does not exist is null."""
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, list):
        return [_finite(v) for v in value]
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    return value


def _csv(accepted: Iterable[Detection]) -> str:
    buffer = StringIO()
    table = csv.writer(buffer, lineterminator="\n")
    table.writerow(_COLUMNS)
    for d in accepted:
        numbers = (*d.position_scene, d.heading_deg, d.score, d.rms_m)
        numbers += (d.coverage_model, d.coverage_scene, d.heading_margin, *d.size_m)
        table.writerow([d.id, d.model, *(f"{n:.4f}" for n in numbers)])
    return buffer.getvalue()


def _write_ply(path: Path, accepted: Sequence[Detection], models: dict[str, ObjectModel]) -> None:
    """The accepted models at their poses in scene coordinates: meshes, or points of a cloud."""
    colours = {name: PALETTE[i % len(PALETTE)] for i, name in enumerate(models)}
    vertices = [cloud_rows(np.empty((0, 3)), np.empty((0, 3), np.uint8), "<f8")]
    faces = [np.empty((0, 3), np.int32)]
    count = 0
    for d in accepted:
        model = models[d.model]
        local = model.vertices if len(model.faces) else model.points
        T_scene_object = d.T_scene_model @ inverse(model.T_object_model)
        xyz = local.astype(np.float64) @ T_scene_object[:3, :3].T + T_scene_object[:3, 3]
        vertices.append(cloud_rows(xyz, np.array(colours[d.model], np.uint8), "<f8"))
        faces.append(model.faces + count)
        count += len(xyz)
    write_ply(path, np.concatenate(vertices), np.concatenate(faces))
