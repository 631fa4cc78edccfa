"""``report.html``: one file that tells what a run found and why, without a network."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from spinpipe.pipeline.config import RunConfig
from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.closeup import SIGHT, WHAT, Closeup, closeups, worth_a_look
from spinpipe.pipeline.drawing.texts import LOW
from spinpipe.pipeline.drawing.top_view import TopView
from spinpipe.pipeline.results.candidate_pictures import (
    COLUMNS,
    POINTS,
    SIDE_PX,
    SIGHT_COLOURS,
    VIEWS,
    WHAT_COLOURS,
    sprite_sheet,
)
from spinpipe.pipeline.results.instances import ReadTopic, box_corners, entry, plain
from spinpipe.pipeline.results.life import limit_tests
from spinpipe.schemas import SAMPLING, SCENE, SPIN_IMAGES
from spinpipe.schemas.arrays import F32
from spinpipe.schemas.records import Detection, ObjectModel

PICTURED = 300
"""Candidates with pictures."""
DATA = "/*DATA*/"


def write_report(
    read: ReadTopic,
    config: RunConfig,
    detections: Sequence[Detection],
    models: Mapping[str, ObjectModel],
    view: TopView,
    report: Mapping[str, Any],
    path: Path,
) -> None:
    """Write the page.

    Parameters
    ----------
    read : reader of the run.
    config : of the run.
    detections, models : what it found, and of what.
    view : the scene from above.
    report : content of report.json.
    path : file to write.
    """
    ranked = worth_a_look(detections, PICTURED)
    shown: list[Closeup] = list(closeups(read, ranked, POINTS))
    sheet, count = sprite_sheet(shown)
    spins = {c.detection.id: _image(c.spin) for c in shown if c.spin.size}
    scene, sampling = read(SCENE)[0], read(SAMPLING)
    data = {
        "run": config.run.name,
        "scene": scene.source,
        "points": scene.points,
        "sampling": plain(sampling[0]) if len(sampling) else {},
        "fates": {fate: _css(palette.fate_colour(fate)) for fate in palette.FATES},
        "candidates": [_candidate(d, models, view, config) for d in detections],
        "pictured": [d.id for d in ranked[:count]],
        "picture": {"side": SIDE_PX, "columns": COLUMNS, "views": list(VIEWS)},
        "legend": {
            **{n: _css(c) for n, c in zip(WHAT, WHAT_COLOURS.tolist(), strict=True)},
            **{f"surface {n}": _css(c) for n, c in zip(SIGHT, SIGHT_COLOURS.tolist(), strict=True)},
        },
        "spins": spins,
        "model_spins": {i.model: _image(i.values) for i in read(SPIN_IMAGES) if i.role == "model"},
        "map": {"width": view.pixels.shape[1], "height": view.pixels.shape[0]},
        "map_image": _data_url(_jpeg(view.pixels), "image/jpeg"),
        "sheet_image": _data_url(sheet, "image/jpeg"),
        "stages": plain(list(report.get("stages", []))),
        "low": LOW,
        "libraries": plain(dict(report.get("libraries", {}))),
        "config": config.to_toml(),
        "folder": str(path.parent),
    }
    page = files("spinpipe.pipeline.results").joinpath("report.html").read_text(encoding="utf-8")
    text = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("</", "<\\/")
    path.write_text(page.replace(DATA, text), encoding="utf-8")


def _candidate(
    d: Detection, models: Mapping[str, ObjectModel], view: TopView, config: RunConfig
) -> dict[str, Any]:
    """What the page shows of one candidate; pixels are those of the map."""
    corners = view.place(box_corners(d, d.T_world_object)[:4, :2])
    values = entry(d, models)
    for heavy in ("T_scene_model", "quaternion_xyzw", "evidence"):
        values.pop(heavy, None)
    values = {k: round(v, 4) if isinstance(v, float) else v for k, v in values.items()}
    values["polygon"] = np.round(corners, 1).tolist()
    values["parts"] = [[p.name, p.value, p.reference, p.merit] for p in d.parts]
    values["limits"] = [
        [t.what, t.value, t.limit, t.passed] for t in limit_tests(d, config.stages["verify"])
    ]
    return plain(values)


def _image(values: F32) -> dict[str, Any]:
    """A spin image for the page: shape and bytes, scaled to its fullest bin."""
    scaled = np.round(values * (255 / max(float(values.max(initial=0)), 1e-9))).astype(np.uint8)
    return {"shape": list(values.shape), "data": b64encode(scaled.tobytes()).decode()}


def _jpeg(pixels: np.ndarray) -> bytes:
    buffer = BytesIO()
    Image.fromarray(pixels).save(buffer, format="JPEG", quality=80)
    return buffer.getvalue()


def _data_url(data: bytes, kind: str) -> str:
    return f"data:{kind};base64,{b64encode(data).decode()}" if data else ""


def _css(colour: Sequence[int]) -> str:
    return "#" + "".join(f"{int(c):02x}" for c in colour[:3])
