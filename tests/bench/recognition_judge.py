"""Recognition benchmark: the real pipeline on a scene, judged against its labels."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import perf_counter

import numpy as np

from spinpipe.pipeline.commands import execute
from spinpipe.pipeline.config import RunConfig
from spinpipe.pipeline.evaluation.evaluate import evaluate_run
from spinpipe.pipeline.evaluation.evaluation import Match, gave_way
from spinpipe.pipeline.evaluation.report import Evaluation
from spinpipe.pipeline.evaluation.truth import TruthObject
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas.records import Detection
from spinpipe.stages.stage import StageError

RIGHT_HEADING_DEG = 20.0
"""Of a right candidate in the reliability table."""


@dataclass
class Trial:
    """A row of the table; lists are of matches, misses, false ones and judged candidates."""

    part: str
    sought: str
    condition: str
    view: str
    spacings_across: float
    noise: float
    size_m: float
    """Geometric mean of the extents."""
    instances: int = 0
    found: int = 0
    false: int = 0
    ambiguous: int = 0
    candidates: int = 0
    points: int = 0
    seconds: float = 0.0
    position_m: list[float] = field(default_factory=list[float])
    heading_deg: list[float] = field(default_factory=list[float])
    flips: int = 0
    lost_by: dict[str, int] = field(default_factory=dict[str, int])
    misses: list[dict[str, object]] = field(default_factory=list[dict[str, object]])
    intruders: list[dict[str, object]] = field(default_factory=list[dict[str, object]])
    judged: list[tuple[float, bool]] = field(default_factory=list[tuple[float, bool]])
    """Score of the best candidate at each place, and whether it is right."""
    error: str = ""

    def document(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)


def judge(
    trial: Trial,
    config: RunConfig,
    folder: Path,
    truth: Path,
    radius_m: float,
    symmetry: int,
    name_of: Callable[[TruthObject], str],
    stands_on: Callable[[Detection], str],
) -> None:
    """Run a config and fill in the trial.

    Parameters
    ----------
    radius_m : farthest match.
    symmetry : headings that look alike; 0: all.
    name_of, stands_on : how an instance stands, and what a false detection stands on.
    """
    output = RunFolder(folder / "run")
    began = perf_counter()
    try:
        execute(config, output, None, None, "off", quiet=True)
        rule = "name" if trial.part == "artificial" else "any"
        result = evaluate_run(output, truth, radius_m=radius_m, rule=rule)
    except StageError as error:
        # a run that stops finds nothing
        trial.error = str(error)
        trial.instances = _count_wanted(truth)
        trial.lost_by = {trial.error.partition(":")[0]: trial.instances}
        return
    finally:
        trial.seconds = perf_counter() - began
    score = result.accepted
    trial.instances = len(score.matches) + len(score.missed)
    trial.found, trial.false = len(score.matches), len(score.false)
    trial.candidates = len(result.detections)
    trial.ambiguous = sum(d.fate == "ambiguous" for d in result.detections)
    trial.position_m = [m.distance_m for m in score.matches]
    errors = [heading_error(m, symmetry) for m in score.matches]
    trial.heading_deg = [e for e in errors if e is not None]
    trial.flips = sum(m.flipped for m in score.matches) if symmetry == 1 else 0
    trial.lost_by = dict(Counter(loss.stage for loss in result.losses))
    by_id = {d.id: d for d in result.detections}
    for loss in result.losses:
        d = None if loss.candidate is None else by_id[loss.candidate]
        said = {"kind": name_of(result.truths[loss.truth]), "stage": loss.stage}
        trial.misses.append({**said, "detail": loss.detail, **_parts(d)})
    for intruder in result.intruders:
        d = result.detections[intruder.detection]
        trial.intruders.append({"kind": intruder.kind, "on": stands_on(d), **_parts(d)})
    trial.judged = _judged(result, radius_m, symmetry)


def _count_wanted(truth: Path) -> int:
    with truth.open(newline="", encoding="utf-8") as stream:
        return sum(row.get("ignore", "0") in ("", "0") for row in csv.DictReader(stream))


def heading_error(match: Match, symmetry: int) -> float | None:
    """Absolute error in degrees modulo the object's symmetry, a flip left out; None if unknown."""
    if symmetry == 0:
        return None
    if match.heading_error_deg is None:
        return match.axis_error_deg
    turn = 180.0 if symmetry == 1 else 360.0 / symmetry
    return abs((match.heading_error_deg + turn / 2) % turn - turn / 2)


def _judged(result: Evaluation, radius_m: float, symmetry: int) -> list[tuple[float, bool]]:
    """Score and rightness of the best candidate at each place, labels to be ignored left out."""
    judged: list[tuple[float, bool]] = []
    kept: list[Detection] = []
    for d in sorted(result.detections, key=lambda d: -d.score):
        apart = max(min(d.size_m[:2]) / 2, 1e-6)
        if gave_way(d) or any(_apart(d, k.position_world) < apart for k in kept):
            continue
        kept.append(d)
        near = [t for t in result.truths if _apart(d, t.position) <= radius_m]
        if not any(t.ignore for t in near):
            judged.append((d.score, any(_turned_right(d, t, symmetry) for t in near)))
    return judged


def _apart(d: Detection, position: Sequence[float]) -> float:
    return float(np.hypot(d.position_world[0] - position[0], d.position_world[1] - position[1]))


def _turned_right(d: Detection, truth: TruthObject, symmetry: int) -> bool:
    if symmetry == 0:
        return True
    known, turn = truth.heading_deg, 360.0 / symmetry
    if known is None:
        known, turn = truth.axis_deg, 180.0
    if known is None:
        return True
    return abs((d.heading_deg - known + turn / 2) % turn - turn / 2) <= RIGHT_HEADING_DEG


def _parts(d: Detection | None) -> dict[str, object]:
    if d is None:
        return {}
    return {
        "id": d.id,
        "score": round(d.score, 3),
        "observed": round(d.observed, 3),
        "rms_m": round(d.rms_m, 4),
        "parts": {p.name: round(p.value, 2) for p in d.parts},
        "reason": d.reason,
    }
