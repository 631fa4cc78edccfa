"""The life of one candidate, from its hits to what decided: every value beside its limit."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from spinpipe.pipeline.config import RunConfig
from spinpipe.pipeline.results.instances import ReadTopic
from spinpipe.schemas import CLUSTERS, DETECTIONS, HITS, SPIN_IMAGES, TRACES
from spinpipe.schemas.records import Detection, Part
from spinpipe.stages.stage import Section, StageError


@dataclass(frozen=True)
class Test:
    """One test that the candidate met, in the order in which it met them."""

    stage: str
    what: str
    value: str
    limit: str = ""
    passed: bool | None = None
    """``None`` where nothing was tested."""
    key: str = ""
    """Of the config, that says the limit; then the two numbers."""
    found: float = 0.0
    wanted: float = 0.0


@dataclass(frozen=True)
class Life:
    """What happened to one candidate and what would have to differ."""

    detection: Detection
    tests: list[Test]
    remedies: list[str]


def find_detection(detections: Sequence[Detection], number: int) -> Detection:
    """The detection with an id.

    Raises
    ------
    StageError
        If there is none.
    """
    for d in detections:
        if d.id == number:
            return d
    ids = sorted(d.id for d in detections)
    known = f"ids go from {ids[0]} to {ids[-1]}" if ids else "the run has no candidates"
    raise StageError(f"no candidate {number}: {known}")


def life_of(d: Detection, read: ReadTopic, config: RunConfig) -> Life:
    """Collect what the run's files say about one candidate."""
    winner = d.duplicate_of if d.duplicate_of >= 0 else None
    tests = [*_scan(d, read, config), *_registration(d, read)]
    limits = list(limit_tests(d, config.stages["verify"]))
    tests += limits
    if winner is not None:
        rival = find_detection(read(DETECTIONS), winner)
        value = f"candidate {winner} ({rival.model}, score {rival.score:.2f}) stands there"
        tests.append(Test("verify", "place is free", value, "no better one", False))
    return Life(d, tests, _remedies(d, limits, winner))


LEANING_DEG = 3.0
"""A support that leans less is said to be level."""
NEARLY = 0.5
"""A limit is offered for change where the value misses it by less than this factor."""


def limit_tests(d: Detection, section: Section) -> list[Test]:
    """Every ``min_x`` and ``max_x`` of the method in ``[verify]`` beside the detection's number."""
    below = "evidence" if getattr(section, "method", "") == "evidence" else "icp"
    limits: Section = getattr(section, below)
    tests: list[Test] = []
    for key in type(limits).model_fields:
        kind, _, name = key.partition("_")
        limit: Any = getattr(limits, key)
        if kind not in ("min", "max") or not isinstance(limit, int | float):
            continue
        names = [f.name for f in dataclasses.fields(d)]
        matching = [n for n in names if n == name] or [n for n in names if n.endswith(f"_{name}")]
        for match in matching:
            value = getattr(d, match)
            if match == "alternative_margin" and not d.alternative:
                continue
            passed = value >= limit if kind == "min" else value <= limit
            if not passed and (d.fate == "accepted" or any(t.passed is False for t in tests)):
                passed = None  # does not apply to it, or was decided before
            sign = "at least" if kind == "min" else "at most"
            words = match.replace("_", " ")
            told = f"{sign} {limit:g} (verify.{below}.{key})"
            rule = (f"verify.{below}.{key}", value, limit)
            tests.append(Test("verify", words, f"{value:.3f}", told, passed, *rule))
    return tests


def _scan(d: Detection, read: ReadTopic, config: RunConfig) -> list[Test]:
    cluster = next((c for c in read(CLUSTERS) if c.id == d.id), None)
    if cluster is None:
        return []
    hits = next((h for h in read(HITS) if h.model == cluster.model), None)
    image = next((i for i in read(SPIN_IMAGES) if i.model == cluster.model), None)
    tests: list[Test] = []
    if hits is not None and len(hits.correlation):
        stated = getattr(config.stages["scan"], "min_correlation", None)
        least = float(stated if stated is not None else hits.correlation.min())
        chosen = "scan.min_correlation" if stated is not None else "the lowest hit of the run"
        limit = f"at least {least:.2f} ({chosen})"
        value = f"{cluster.correlation:.3f} with the spin image of {cluster.model}"
        passed = cluster.correlation >= least - 1e-6
        tests.append(Test("scan", "correlation", value, limit, passed))
        if image is not None:
            size = f"{image.radius_m:.2f} x {image.height_m:.2f} m, bins {image.bin_m:.2f} m"
            tests.append(Test("scan", "spin image", size))
    needed = getattr(config.stages["cluster"], "min_hits", None)
    tests.append(
        Test(
            "cluster",
            "hits in the group",
            f"{cluster.hits} ({cluster.method})",
            f"at least {needed or 1} (cluster.min_hits)",
            cluster.hits >= (needed or 1),
        )
    )
    x, y, z = cluster.position
    tests.append(Test("cluster", "found at, world", f"x {x:z.2f}  y {y:z.2f}  z {z:z.2f} m"))
    return tests


def _registration(d: Detection, read: ReadTopic) -> list[Test]:
    tests: list[Test] = []
    trace = next((t for t in read(TRACES) if t.cluster == d.id), None)
    if trace is not None:
        steps = max(len(trace.poses) - 1, 1)
        value = f"{len(trace.start_heading_deg)} starts as {d.model}, {steps} steps of the best"
        tests.append(Test("verify", "registration", value))
    off = f"{d.rms_m:.3f} m of the points within {d.gate_m:.2f} m"
    tests.append(Test("verify", "residual", off if np.isfinite(d.rms_m) else "no points"))
    if np.isfinite(d.runner_up_rms_m):
        rival = f"{d.runner_up_heading_deg:.0f}°, residual {d.runner_up_rms_m:.3f} m"
        tests.append(Test("verify", "runner-up heading", rival))
    if d.alternative:
        rival = f"{d.alternative}, {d.alternative_margin:.3f} behind"
        tests.append(Test("verify", "next best model", rival))
    seen = f"{d.coverage_model:.0%} of the model's visible surface seen, {d.observed:.0%} observed"
    tests.append(Test("verify", "model in the scene", seen))
    tests.append(
        Test("verify", "scene in the model", f"{d.coverage_scene:.0%} explained, chance included")
    )
    if d.tilt_deg >= LEANING_DEG:
        tests.append(Test("verify", "leans with its support", f"{d.tilt_deg:.1f}°"))
    return tests


def deciding_part(d: Detection) -> Part | None:
    """The part that speaks loudest against: by its merit, else its value."""
    if any(part.merit for part in d.parts):
        return min(d.parts, key=lambda part: part.merit)
    return min(d.parts, key=lambda part: part.value / part.reference, default=None)


def _remedies(d: Detection, limits: Sequence[Test], winner: int | None) -> list[str]:
    if d.fate == "accepted":
        return []
    if winner is not None:
        return [f"nothing: candidate {winner} is the instance that stands here"]
    failed = next((test for test in limits if test.passed is False), None)
    if failed is None:
        return [f"what made it {d.fate}: {d.reason}"]
    advice = [f"{failed.what} {failed.value} would have to be {failed.limit}"]
    if NEARLY * failed.wanted <= failed.found <= failed.wanted / NEARLY:
        advice.append(f"to see what else would pass with it: --set {failed.key}={failed.found:.3f}")
    return advice
