"""Detections in the formats of other tools: one object per id in each of them."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from spinpipe.pipeline.results.geojson import geojson
from spinpipe.pipeline.results.instances import ROW_COLUMNS, ReadTopic, entry, mesh_of, row
from spinpipe.pipeline.scenes.write_ply import cloud_rows, write_ply
from spinpipe.schemas import SCENE
from spinpipe.schemas.records import Detection, ObjectModel

PALETTE = ((0, 158, 115), (0, 114, 178), (213, 94, 0), (204, 121, 167), (230, 159, 0))
"""Colours of models that colour-blind people can tell apart (Okabe and Ito)."""


@dataclass(frozen=True)
class Export:
    """What is written: detections of a run, and where the rest of the run is read from."""

    run: str
    detections: Sequence[Detection]
    models: Mapping[str, ObjectModel]
    read: ReadTopic


def write_csv(export: Export, path: Path) -> None:
    """One row a detection; a number that does not exist is an empty cell."""
    buffer = StringIO()
    table = csv.writer(buffer, lineterminator="\n")
    table.writerow(ROW_COLUMNS)
    for d in export.detections:
        table.writerow(_cell(value) for value in row(d, export.models).values())
    path.write_text(buffer.getvalue(), encoding="utf-8")


def _cell(value: object) -> object:
    if isinstance(value, float | np.floating):
        return f"{value:.4f}" if np.isfinite(value) else ""
    return value


def write_json(export: Export, path: Path) -> None:
    """The document of detections.json, see docs/results.md."""
    entries = [entry(d, export.models) for d in export.detections]
    document = {"schema": 2, "run": export.run, "detections": entries}
    path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def write_geojson(export: Export, path: Path) -> None:
    """Footprints in longitude and latitude."""
    text = geojson(export.detections, export.models, export.read(SCENE)[0].crs)
    path.write_text(text, encoding="utf-8")


def write_meshes(export: Export, path: Path) -> None:
    """PLY of the fitted models in scene coordinates; each vertex knows its ``object_id``."""
    colours = {name: PALETTE[i % len(PALETTE)] for i, name in enumerate(export.models)}
    dtype = [*cloud_rows(np.empty((0, 3)), np.empty((0, 3), np.uint8), "<f8").dtype.descr]
    vertices = [np.empty(0, [*dtype, ("object_id", "<i4")])]
    faces = [np.empty((0, 3), np.int32)]
    count = 0
    for d in export.detections:
        xyz, triangles = mesh_of(d, export.models)
        rows = np.empty(len(xyz), vertices[0].dtype)
        plain_rows = cloud_rows(xyz, np.array(colours[d.model], np.uint8), "<f8")
        for name in plain_rows.dtype.names or ():
            rows[name] = plain_rows[name]
        rows["object_id"] = d.id
        vertices.append(rows)
        faces.append(triangles + count)
        count += len(xyz)
    write_ply(path, np.concatenate(vertices), np.concatenate(faces))


def write_obj(export: Export, path: Path) -> None:
    """Wavefront OBJ in scene coordinates: an object ``<id>_<model>`` for each detection."""
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# spinpipe run {export.run}, scene coordinates\n")
        first = 1
        for d in export.detections:
            xyz, triangles = mesh_of(d, export.models)
            file.write(f"o {d.id}_{'_'.join(d.model.split())}\n")
            np.savetxt(file, xyz, "v %.6f %.6f %.6f")
            if len(triangles):
                np.savetxt(file, triangles + first, "f %d %d %d")
            else:
                file.write("p " + " ".join(map(str, range(first, first + len(xyz)))) + "\n")
            first += len(xyz)


def write_kitti(export: Export, path: Path) -> None:
    """KITTI's object labels [Geiger et al. 2012]: h w l, x y z, rotation_y, score.

    KITTI's frame is a camera's: here one at the world's origin that looks along +x with z up, so
    ``x = -y_world, y = -z_world, z = x_world`` and ``rotation_y = -heading - 90 degrees``. The
    fields of the image (truncation, occlusion, alpha, box) are the benchmark's "unknown".
    """
    with path.open("w", encoding="utf-8") as file:
        for d in export.detections:
            (x, y, z), (length, width, height) = d.position_world, d.size_m
            turn = np.radians(-d.heading_deg - 90.0)
            turn = float(np.arctan2(np.sin(turn), np.cos(turn)))
            numbers = (height, width, length, -y, -z, x, turn, d.score)
            name = "_".join(d.model.split())
            line = " ".join(f"{n:z.4f}" for n in numbers)
            file.write(f"{name} -1 -1 -10 -1 -1 -1 -1 {line}\n")


def write_labelled_las(export: Export, path: Path) -> None:
    """LAS of the scene's points with the id of the object that each belongs to."""
    from spinpipe.pipeline.results.labelled_cloud import write_las

    write_las(export.read, export.detections, path)


def write_merged_mcap(export: Export, path: Path) -> None:
    """The run as one MCAP file, see docs/foxglove.md."""
    from spinpipe.pipeline.results.merged_mcap import write_mcap

    write_mcap(export.read, export.detections, path)


FORMATS: dict[str, Callable[[Export, Path], None]] = {
    "csv": write_csv,
    "json": write_json,
    "geojson": write_geojson,
    "ply": write_meshes,
    "obj": write_obj,
    "kitti": write_kitti,
    "las": write_labelled_las,
    "mcap": write_merged_mcap,
}
SUFFIX = {"kitti": "txt"}
"""Of the file, where it is not the format's name."""
