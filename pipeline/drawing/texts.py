"""What the pane of notes says about a candidate and about the outcome, as markdown."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from spinpipe.pipeline.drawing import palette
from spinpipe.schemas.records import Detection, Part

NOTED = 80
AGAINST = -0.5
"""A part that adds less to the log odds speaks against a candidate."""
LOW = {
    "model": "the scene shows something else where its surface should be seen",
    "sides": "its upright sides are missing or elsewhere in the scene",
    "scene": "points in its box lie on its surface hardly more often than by chance",
    "residual": "points are near its surface, but farther off than a right one's",
    "outline": "the scene goes on where the model ends, instead of dropping",
    "stands": "its base is not on what it stands on, or that falls away around it",
    "alike": "it fits worse, or shows less of its sides, than the others found here",
}
"""What is wrong with a candidate of which a part is low, in words."""


def against(parts: Sequence[Part]) -> list[Part]:
    """The parts that speak against a candidate, the loudest first."""
    return sorted((p for p in parts if p.merit < AGAINST), key=lambda p: p.merit)


def candidate_text(d: Detection) -> str:
    """Why a candidate won or lost: the reason and its numbers."""
    x, y, z = d.position_scene
    fate = f"duplicate of {d.duplicate_of}" if d.fate == "duplicate" else d.fate
    lines = [
        f"### Candidate {d.id}: {d.model} {fate}",
        f"**{d.reason}**" + (f" (cause: {d.cause})" if d.cause else ""),
        "",
        f"x_scene {x:z.2f}, y_scene {y:z.2f}, z_scene {z:z.2f}; "
        f"heading_world {d.heading_deg:.0f}°, leaning {d.tilt_deg:.0f}°",
    ]
    rival = f"{d.runner_up_rms_m:.3f} m at {d.runner_up_heading_deg:.0f}°"
    numbers = [
        ("score", f"{d.score:.3f}, needs {d.min_score:g}"),
        ("log odds", f"{d.log_odds:+.1f}"),
        ("correlation", f"{d.correlation:.3f}"),
        ("residual", f"{d.rms_m:.3f} m, within {d.gate_m:.2f} m"),
        ("runner-up", rival if math.isfinite(d.runner_up_rms_m) else "none"),
        ("margin of the heading", f"{d.heading_margin:.2f}"),
        ("model's surface seen", f"{d.coverage_model:.0%}, observed {d.observed:.0%}"),
        ("scene explained", f"{d.coverage_scene:.0%}"),
    ]
    if d.alternative:
        numbers.append(("next best model", f"{d.alternative}, {d.alternative_margin:.2f} behind"))
    lines += [""] + [f"- {p.name} {p.merit:+.1f}: {LOW.get(p.name, '')}" for p in against(d.parts)]
    lines += ["", "| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in numbers)]
    lines += ["", "Points: blue explained, orange not, grey ground. ", ""]
    lines += ["Surface: green seen, red contradicted, grey not observed.", ""]
    lines += [
        "Bars: a part; white mark: of a right instance; number: what it adds to the log odds."
    ]
    return "\n".join(lines)


def outcome_text(detections: Sequence[Detection]) -> str:
    """How many of which fate, and every kept one with its reason."""
    fates = Counter(d.fate for d in detections)
    kept = sorted((d for d in detections if d.fate in palette.KEPT), key=lambda d: -d.score)
    kept.sort(key=lambda d: palette.rank(d.fate))
    lines = [
        "## " + ", ".join(f"{fates[fate]} {fate}" for fate in palette.FATES if fates[fate]),
        "",
        "Candidate 42 is step 42 000 of the timeline `candidate`.",
        "",
        "| id | model | x_scene | y_scene | score | fate |",
        "|---|---|---|---|---|---|",
    ]
    for d in kept[:NOTED]:
        x, y, _ = d.position_scene
        lines.append(f"| {d.id} | {d.model} | {x:.2f} | {y:.2f} | {d.score:.2f} | {d.fate} |")
    lines += ["", *(f"- {d.id}: {d.reason}" for d in kept[:NOTED] if d.fate != "accepted")]
    if len(kept) > NOTED:
        lines.append(f"\n... and {len(kept) - NOTED} more: see report.html")
    return "\n".join(lines)
