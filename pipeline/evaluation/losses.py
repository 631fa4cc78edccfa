"""Where a labelled object was lost on its way through the stages, and how a false one got in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import KDTree

from spinpipe.pipeline.evaluation.evaluation import Rule, Score, distances, gave_way
from spinpipe.pipeline.evaluation.truth import TruthObject
from spinpipe.pipeline.results.instances import ReadTopic
from spinpipe.schemas import CLUSTERS, HITS, MODELS, SCORES
from spinpipe.schemas.arrays import F32, F64
from spinpipe.schemas.records import Detection, ObjectModel


@dataclass(frozen=True)
class Loss:
    """A labelled object that was not found."""

    truth: int
    """Place in the list of truths."""
    stage: str
    """``scan``: no hit; ``cluster``: hits, but no candidate; ``verify``: rejected, moved away or
    undecided; ``resolve``: gave way to another one; ``type``: found as another model."""
    detail: str
    candidate: int | None = None
    """Id of the detection that stood for it, if there was one."""
    score: float | None = None


@dataclass(frozen=True)
class Intruder:
    """An accepted detection where no labelled object is left for it."""

    detection: int
    """Place in the list of detections."""
    kind: str
    """``duplicate`` of an object that another detection found, ``wrong type`` on an object of
    another model, ``displaced``: beyond the radius, but on the object; ``clutter``: nothing."""
    detail: str


def find_losses(
    score: Score,
    truths: Sequence[TruthObject],
    detections: Sequence[Detection],
    read: ReadTopic,
    radius_m: float,
    rule: Rule,
) -> list[Loss]:
    """Name the stage that lost each missed object, from the messages of the run."""
    if not score.missed:
        return []
    missed = [truths[i] for i in score.missed]
    trail = _Trail(missed, detections, read, radius_m, rule)
    found_by = {m.detection: truths[m.truth] for m in score.matches}
    return [trail.loss(row, i, found_by) for row, i in enumerate(score.missed)]


def find_intruders(
    score: Score,
    truths: Sequence[TruthObject],
    detections: Sequence[Detection],
    radius_m: float,
) -> list[Intruder]:
    """Say what each false detection stands on."""
    positions = np.array([detections[i].position_world for i in score.false])
    far = distances(truths, positions)
    found_by = {m.truth: detections[m.detection].id for m in score.matches}
    intruders: list[Intruder] = []
    for column, i in enumerate(score.false):
        if not len(truths):
            intruders.append(Intruder(i, "clutter", "nothing is labelled"))
            continue
        nearest = int(np.argmin(far[:, column]))
        truth, distance = truths[nearest], float(far[nearest, column])
        on = f"{distance:.2f} m from {describe(truth)}"
        if distance > radius_m:
            near = distance < max(detections[i].size_m[:2]) / 2
            intruders.append(Intruder(i, "displaced" if near else "clutter", on))
        elif nearest in found_by:
            found = f"{on}, found by {found_by[nearest]}"
            intruders.append(Intruder(i, "duplicate", found))
        else:
            intruders.append(Intruder(i, "wrong type", on))
    return intruders


def describe(truth: TruthObject) -> str:
    """Name a labelled object by its model and its line in the file."""
    return f"{truth.model or 'object'} in line {truth.row}"


class _Trail:
    """What the stages say near each missed object."""

    def __init__(
        self,
        missed: Sequence[TruthObject],
        detections: Sequence[Detection],
        read: ReadTopic,
        radius_m: float,
        rule: Rule,
    ) -> None:
        self._missed = missed
        self._detections = detections
        self._read = read
        self._rule = rule
        self._reach_m = {m.name: radius_m + _top_offset_m(m) for m in read(MODELS)}
        self._sought = np.array(
            [[self._is_sought(t, d.model) for d in detections] for t in missed], bool
        ).reshape(len(missed), len(detections))
        self._distance = distances(missed, np.array([d.position_world for d in detections]))
        clusters = {c.id: c.position for c in read(CLUSTERS)}
        starts = np.array([clusters[d.id] for d in detections]).reshape(-1, 3)
        reach = np.array([self._reach_m[d.model] for d in detections])
        self._start_distance = _horizontal(missed, starts)
        self._began = self._start_distance <= reach
        self._ended = self._distance <= radius_m
        self._hits = self._count_hits()

    def loss(self, row: int, index: int, found_by: dict[int, TruthObject]) -> Loss:
        """Why the truth at ``row`` of the missed ones, ``index`` of all, was not found."""
        other = self._other_model(row)
        if other is not None:
            return Loss(index, "type", f"found as {other.model}", other.id, other.score)
        candidate = self._best_candidate(row)
        if candidate is not None:
            d = self._detections[candidate]
            stage, detail = self._fate(row, candidate, found_by)
            return Loss(index, stage, detail, d.id, d.score)
        if self._hits[row]:
            return Loss(index, "cluster", f"{self._hits[row]} hits made no candidate")
        return Loss(index, "scan", self._why_no_hit(row))

    def _best_candidate(self, row: int) -> int | None:
        """Pick the best detection that ended here, else the one that began nearest to here."""
        ended = np.flatnonzero(self._ended[row] & self._sought[row])
        if len(ended):
            scores = [self._detections[i].score for i in ended.tolist()]
            return int(ended[int(np.argmax(scores))])
        began = np.flatnonzero(self._began[row] & self._sought[row])
        if len(began):
            return int(began[int(np.argmin(self._start_distance[row, began]))])
        return None

    def _fate(self, row: int, candidate: int, found_by: dict[int, TruthObject]) -> tuple[str, str]:
        d = self._detections[candidate]
        if not self._ended[row, candidate]:
            away = f"its candidate ended {self._distance[row, candidate]:.2f} m away"
            return "verify", f"{away}, {d.fate}: {d.reason}"
        if d.fate in ("duplicate", "rejected"):
            return ("resolve" if gave_way(d) else "verify"), d.reason
        if candidate in found_by:
            return "verify", f"its candidate took {describe(found_by[candidate])}"
        return "verify", f"{d.fate}: {d.reason}"

    def _other_model(self, row: int) -> Detection | None:
        """Find the nearest accepted detection of another model on the object."""
        accepted = np.array([d.fate == "accepted" for d in self._detections], bool)
        places = np.flatnonzero(self._ended[row] & ~self._sought[row] & accepted)
        if not len(places):
            return None
        return self._detections[int(places[np.argmin(self._distance[row, places])])]

    def _is_sought(self, truth: TruthObject, model: str) -> bool:
        return self._rule == "any" or not truth.model or truth.model == model

    def _count_hits(self) -> list[int]:
        counts = np.zeros(len(self._missed), int)
        for hits in self._read(HITS):
            near = _near_points(self._missed, hits.points, self._reach_m[hits.model])
            sought = [self._is_sought(t, hits.model) for t in self._missed]
            counts += [len(rows) if s else 0 for rows, s in zip(near, sought, strict=True)]
        return counts.tolist()

    @cached_property
    def _best_correlation(self) -> list[float]:
        """The best of any origin near each missed object; -inf where there is none."""
        best = [-math.inf] * len(self._missed)
        for tile in self._read(SCORES):
            for column, model in enumerate(tile.models):
                near = _near_points(self._missed, tile.points, self._reach_m[model])
                for row, rows in enumerate(near):
                    if rows and self._is_sought(self._missed[row], model):
                        best[row] = max(best[row], float(tile.correlation[rows, column].max()))
        return best

    def _why_no_hit(self, row: int) -> str:
        best = self._best_correlation[row]
        if best == -math.inf:
            return "no hit: no scene point here stands as high as the model's top"
        return f"no hit: the best correlation was {best:.2f}"


def _top_offset_m(model: ObjectModel) -> float:
    """How far from the base centre the topmost point, where hits are, stands."""
    top = model.points[np.argmax(model.points[:, 2])]
    return float(np.hypot(top[0], top[1]))


def _places(truths: Sequence[TruthObject]) -> F64:
    return np.array([t.position[:2] for t in truths])


def _horizontal(truths: Sequence[TruthObject], points: F64) -> F64:
    """(T, N) horizontal distances in metres."""
    return np.linalg.norm(_places(truths)[:, None] - points[None, :, :2], axis=2)


def _near_points(truths: Sequence[TruthObject], points: F32, reach_m: float) -> list[list[int]]:
    """Rows of the points (N, 3) that stand horizontally within reach of each truth."""
    if not len(points):
        return [[] for _ in truths]
    return list(KDTree(points[:, :2]).query_ball_point(_places(truths), reach_m))
