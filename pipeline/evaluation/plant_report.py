"""How planted objects were found, by how much of them the scene leaves to be seen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from spinpipe.pipeline.evaluation.evaluation import Match, percentiles
from spinpipe.pipeline.evaluation.report import Evaluation
from spinpipe.pipeline.scenes.planted_scene import Planted

CLASSES = (("seen whole", 0.95), ("most of it", 0.75), ("half or more", 0.5), ("less", 0.0))
"""Name and least visibility of each class."""


def visibility_class(visibility: float) -> str:
    """Name of the class that a visibility in 0..1 falls into."""
    return next(name for name, least in CLASSES if visibility >= least)


def plant_table(evaluation: Evaluation, planted: Sequence[Planted]) -> Group:
    """Recall and errors by visibility; the truth's first rows are the planted objects."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("visibility", no_wrap=True)
    for name in ("planted", "found", "recall", "type", "position", "95 %", "heading", "flips"):
        table.add_column(name, justify="right", no_wrap=True)
    for name in (*(name for name, _ in CLASSES), "all"):
        entry = _summary(evaluation, planted, name)
        if entry["planted"]:
            table.add_row(
                name,
                str(entry["planted"]),
                str(entry["found"]),
                f"{entry['recall']:.3f}",
                str(entry["right_type"]),
                _text(entry["position_m"]["median"], ".2f", " m"),
                _text(entry["position_m"]["p95"], ".2f", " m"),
                _text(entry["heading_deg"]["median"], ".1f", "°"),
                str(entry["flipped"]),
            )
    lost = Counter(loss.stage for loss in evaluation.losses)
    lines = [f"lost by {stage}: {count}" for stage, count in lost.most_common()]
    lines.append(f"false ones that the scene did not have before: {len(evaluation.intruders)}")
    return Group(table, *(Text(line) for line in lines))


def plant_document(evaluation: Evaluation, planted: Sequence[Planted]) -> dict[str, Any]:
    """Content of plant.json."""
    matches = {m.truth: m for m in evaluation.accepted.matches}
    losses = {loss.truth: loss for loss in evaluation.losses}
    names = (*(name for name, _ in CLASSES), "all")
    objects: list[dict[str, Any]] = []
    for i, p in enumerate(planted):
        match, loss = matches.get(i), losses.get(i)
        objects.append(
            {
                "model": p.model,
                "position_world": p.plant.T_world_object[:3, 3].tolist(),
                "visibility": p.plant.visibility,
                "points": len(p.plant.points),
                "density_per_m2": p.plant.surroundings.density,
                "noise_m": p.plant.surroundings.noise_m,
                "found_as": evaluation.detections[match.detection].model if match else None,
                "detection": evaluation.detections[match.detection].id if match else None,
                "position_error_m": match.distance_m if match else None,
                "heading_error_deg": match.heading_error_deg if match else None,
                "lost_by": loss.stage if loss else None,
                "why": loss.detail if loss else None,
            }
        )
    return {
        "schema": 1,
        "run": evaluation.run,
        "radius_m": evaluation.radius_m,
        "by_visibility": {name: _summary(evaluation, planted, name) for name in names},
        "false": [evaluation.detections[i.detection].id for i in evaluation.intruders],
        "objects": objects,
    }


def _summary(evaluation: Evaluation, planted: Sequence[Planted], name: str) -> dict[str, Any]:
    rows = [
        i for i, p in enumerate(planted) if name in ("all", visibility_class(p.plant.visibility))
    ]
    matches = [m for m in evaluation.accepted.matches if m.truth in rows]
    return {
        "planted": len(rows),
        "found": len(matches),
        "recall": len(matches) / len(rows) if rows else None,
        "right_type": sum(_right_type(evaluation, planted, m) for m in matches),
        "position_m": _errors([m.distance_m for m in matches]),
        "heading_deg": _errors([m.axis_error_deg for m in matches]),
        "flipped": sum(m.flipped for m in matches),
    }


def _right_type(evaluation: Evaluation, planted: Sequence[Planted], match: Match) -> bool:
    return evaluation.detections[match.detection].model == planted[match.truth].model


def _errors(values: Sequence[float | None]) -> dict[str, float | None]:
    median, p95 = percentiles(values, 50, 95)
    return {"median": median, "p95": p95}


def _text(value: float | None, form: str, unit: str) -> str:
    return "-" if value is None else format(value, form) + unit
