"""Detections against ground truth: one-to-one matches, recall, precision, errors, the PR curve.

Everything is in the world frame. Pure functions of their arguments: no files, no terminal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from spinpipe.pipeline.evaluation.truth import TruthObject
from spinpipe.schemas.arrays import F64, Mask
from spinpipe.schemas.records import Detection

Rule = Literal["name", "any"]
"""Whether a detection must have the model that the truth names."""


@dataclass(frozen=True)
class Match:
    """A labelled object and the detection that found it, by their places in the lists."""

    truth: int
    detection: int
    distance_m: float
    """Horizontal."""
    height_error_m: float | None
    """Detection minus truth; None where the truth has no z."""
    heading_error_deg: float | None
    """Signed, (-180, 180]; None where the truth has no heading."""
    axis_error_deg: float | None
    """0..90, whichever end is the front; None where the truth has no axis."""

    @property
    def flipped(self) -> bool:
        """Whether the front is taken for the back."""
        return self.heading_error_deg is not None and abs(self.heading_error_deg) > 90.0


@dataclass(frozen=True)
class Score:
    """Counts of one selection of detections, and what follows from them."""

    matches: tuple[Match, ...]
    missed: tuple[int, ...]
    """Places in the list of truths."""
    false: tuple[int, ...]
    """Places in the list of detections."""
    neither: tuple[int, ...]
    """Detections on objects to be ignored."""

    @property
    def recall(self) -> float | None:
        """Share of the labelled objects that were found; None without any."""
        return _ratio(len(self.matches), len(self.matches) + len(self.missed))

    @property
    def precision(self) -> float | None:
        """Share of the detections that are right; None without any."""
        return _ratio(len(self.matches), len(self.matches) + len(self.false))

    @property
    def f1(self) -> float | None:
        """Harmonic mean of recall and precision."""
        found = 2 * len(self.matches)
        return _ratio(found, found + len(self.missed) + len(self.false))


@dataclass(frozen=True)
class Curve:
    """Precision and recall when all detections with at least a score are accepted."""

    score: F64
    """(K,) descending."""
    recall: F64
    precision: F64
    average_precision: float


def choose_rule(truths: Sequence[TruthObject], models: Sequence[str]) -> Rule:
    """``name`` if a name of the truth is among the run's models, else ``any``."""
    return "name" if any(t.model in models for t in truths) else "any"


def score_detections(
    truths: Sequence[TruthObject],
    detections: Sequence[Detection],
    chosen: Sequence[int],
    radius_m: float,
    rule: Rule,
) -> Score:
    """Match some of the detections to the truths, one to one.

    As many matches as possible, and among those the ones with the least sum of distances.

    Parameters
    ----------
    truths, detections : what is there and what was found.
    chosen : which detections count as found, places in ``detections``.
    radius_m : farthest match: horizontally, or in space where the truth has a z.
    rule : see ``Rule``.
    """
    near = _near(truths, detections, chosen, radius_m, rule)
    wanted = [i for i, t in enumerate(truths) if not t.ignore]
    pairs = nearest_pairs(near[wanted])
    matches = tuple(_match(truths, detections, wanted[r], chosen[c]) for r, c in pairs)
    taken = {m.detection for m in matches}
    ignored = np.any(np.isfinite(near[[i for i, t in enumerate(truths) if t.ignore]]), axis=0)
    left = [(d, bool(ignored[c])) for c, d in enumerate(chosen) if d not in taken]
    found = {m.truth for m in matches}
    return Score(
        matches=matches,
        missed=tuple(i for i in wanted if i not in found),
        false=tuple(d for d, on_ignored in left if not on_ignored),
        neither=tuple(d for d, on_ignored in left if on_ignored),
    )


def nearest_pairs(distance: F64) -> list[tuple[int, int]]:
    """Pairs of rows and columns, each used once: as many as possible, then the nearest.

    Parameters
    ----------
    distance : (R, C) metres, infinite where a pair is not allowed.
    """
    allowed = np.isfinite(distance)
    # One pair that is not allowed costs more than all others: matches come first
    largest = float(distance[allowed].max()) if allowed.any() else 0.0
    forbidden = largest * (min(distance.shape) + 1) + 1.0
    rows, columns = linear_sum_assignment(np.where(allowed, distance, forbidden))
    return [(int(r), int(c)) for r, c in zip(rows, columns, strict=True) if allowed[r, c]]


def precision_recall(
    truths: Sequence[TruthObject],
    detections: Sequence[Detection],
    radius_m: float,
    rule: Rule,
) -> Curve:
    """Accept every candidate from a score upwards, for every score there is.

    Rejected candidates take part, but a place holds one instance: a rejected one that gave way to
    a better one, or stands less than half its width from one, is left out. The average precision
    is the area under the curve whose precision is made non-increasing
    [Everingham et al. 2010, section 4.2].
    """
    order = sorted(range(len(detections)), key=lambda i: (-detections[i].score, detections[i].id))
    order = _one_a_place(detections, order)
    near = _near(truths, detections, order, radius_m, rule)
    wanted = np.array([not t.ignore for t in truths], bool)
    right = _matched(np.isfinite(near) & wanted[:, None])
    wrong = ~right & ~np.isfinite(near[~wanted]).any(axis=0)
    score = np.array([detections[i].score for i in order])
    last = np.flatnonzero(np.diff(score, append=-np.inf))  # equal scores are accepted together
    found, false = np.cumsum(right)[last], np.cumsum(wrong)[last]
    counted = found + false > 0
    score, found, false = score[last][counted], found[counted], false[counted]
    recall = found / max(1, int(wanted.sum()))
    precision = found / (found + false)
    ceiling = np.maximum.accumulate(precision[::-1])[::-1]
    area = float(np.sum(np.diff(recall, prepend=0.0) * ceiling))
    return Curve(score, recall, precision, area)


def _matched(allowed: Mask) -> Mask:
    """Columns (N,) that, added one by one, each make the largest matching with rows larger.

    What is matched once stays matched, so a detection is right or wrong for good when it is added.
    """
    near = np.flatnonzero(allowed.any(axis=0))
    sizes = [
        np.count_nonzero(maximum_bipartite_matching(csr_array(allowed[:, near[: k + 1]])) >= 0)
        for k in range(len(near))
    ]
    found = np.zeros(allowed.shape[1], bool)
    found[near] = np.diff(sizes, prepend=0) > 0
    return found


def _one_a_place(detections: Sequence[Detection], order: list[int]) -> list[int]:
    kept: list[int] = []
    places = np.empty((len(order), 2))
    for i in order:
        d = detections[i]
        place = np.array(d.position_world[:2])
        reach = min(d.size_m[:2]) / 2
        crowded = np.linalg.norm(places[: len(kept)] - place, axis=1) < reach
        if d.fate in ("duplicate", "rejected") and (crowded.any() or gave_way(d)):
            continue
        places[len(kept)] = place
        kept.append(i)
    return kept


def gave_way(detection: Detection) -> bool:
    """Whether a better one stands in the same place."""
    return detection.fate == "duplicate"


def percentiles(values: Sequence[float | None], *levels: float) -> list[float | None]:
    """Percentiles of the values that exist; None where there is none."""
    known = [abs(v) for v in values if v is not None]
    return [float(np.percentile(known, level)) if known else None for level in levels]


def distances(truths: Sequence[TruthObject], positions: F64) -> F64:
    """(T, N) metres from each truth to each position (N, 3): horizontal where z is unknown."""
    places = np.array([t.position for t in truths]).reshape(-1, 3)
    offset = places[:, None] - positions.reshape(-1, 3)[None]
    return np.linalg.norm(np.nan_to_num(offset, nan=0.0), axis=2)


def _near(
    truths: Sequence[TruthObject],
    detections: Sequence[Detection],
    chosen: Sequence[int],
    radius_m: float,
    rule: Rule,
) -> F64:
    """(T, chosen) distances of the pairs that may match, infinite for the others."""
    distance = distances(truths, np.array([detections[i].position_world for i in chosen]))
    distance[distance > radius_m] = np.inf
    if rule == "name":
        names = np.array([detections[i].model for i in chosen], object)
        for row, truth in enumerate(truths):
            if truth.model:
                distance[row, names != truth.model] = np.inf
    return distance


def _match(
    truths: Sequence[TruthObject], detections: Sequence[Detection], truth: int, detection: int
) -> Match:
    t, d = truths[truth], detections[detection]
    offset = np.subtract(d.position_world, t.position)
    heading = None if t.heading_deg is None else 180 - (t.heading_deg - d.heading_deg + 180) % 360
    axis = None if t.axis_deg is None else abs((d.heading_deg - t.axis_deg + 90) % 180 - 90)
    return Match(
        truth=truth,
        detection=detection,
        distance_m=float(np.hypot(offset[0], offset[1])),
        height_error_m=None if np.isnan(offset[2]) else float(offset[2]),
        heading_error_deg=heading,
        axis_error_deg=axis,
    )


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None
