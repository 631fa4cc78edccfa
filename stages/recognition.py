"""Which candidates are instances of which model: hypotheses, evidence, competition, fate.

Every candidate is tried as every model. The best hypotheses are refined, scored and thinned to
distinct places; there all models and four headings compete again from the place found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.hypotheses import EVIDENCE, coarse_poses, refine_poses
from spinpipe.stages.model_field import ModelField
from spinpipe.stages.registration import POSE
from spinpipe.stages.resolve import resolve
from spinpipe.stages.scoring import PARTS, score, score_parts
from spinpipe.stages.surroundings import Sampling, Surroundings, build_surroundings
from spinpipe.stages.tolerance import Tolerance, shell_share, tolerance

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Fate = Literal["accepted", "ambiguous", "rejected"]

COARSE = 3
"""How many coarse poses of a candidate are kept for each model."""
STARTS = 5
"""How many of them are refined, over all models, at least."""
WORTH_A_SECOND_LOOK = 0.02
"""Score from which a place is tried with all models and headings."""


@dataclass(frozen=True, eq=False)
class KnownObject:
    """A model to look for, and what is known of its instances."""

    field: ModelField
    stretch: float = 0.0
    visible_from: Literal["all", "above"] = "all"


@dataclass(frozen=True)
class Rules:
    """When a hypothesis is accepted."""

    min_score: float = 0.5
    min_observed: float = 0.1
    min_margin: float = 0.01
    max_sheltered: float = 0.5


@dataclass(frozen=True, eq=False)
class Verdict:
    """What became of a candidate.

    Attributes
    ----------
    candidate : row of the candidate.
    model : row of the model that explains it best.
    pose : (7,) x, y, z of the base centre, yaw (radians), stretch along the object's axes; world.
    size_m : (3,) fitted extents.
    parts : score parts by name.
    evidence : raw evidence by name.
    score, fate, reason : the decision.
    heading_margin : score minus that of the best other heading of the same model; the score itself
        where the model looks the same from there.
    runner_up : (7,) pose of that other heading.
    runner_up_rms_m : its residual, infinite if there is none.
    alternative, alternative_margin : row of the next best model, -1 if none, and by how much.
    """

    candidate: int
    model: int
    pose: F64
    size_m: F64
    parts: dict[str, float]
    evidence: dict[str, float]
    score: float
    fate: Fate
    reason: str
    heading_margin: float
    runner_up: F64
    runner_up_rms_m: float
    alternative: int
    alternative_margin: float

    @property
    def T_world_object(self) -> F64:
        """(4, 4) pose with the stretch."""
        T = np.eye(4)
        cos, sin = math.cos(self.pose[3]), math.sin(self.pose[3])
        T[:3, :3] = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) * self.pose[4:7]
        T[:3, 3] = self.pose[:3]
        return T

    @property
    def observed(self) -> float:
        """Share of the model's visible area that the scene says anything about."""
        return self.evidence.get("supported", 0.0) + self.evidence.get("contradicted", 0.0)


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses as columns: which candidate, which model, where, how good."""

    candidate: I64
    model: I64
    pose: F64
    parts: F64
    evidence: F64
    score: F64

    def rows(self, chosen: NDArray[np.integer] | NDArray[np.bool_]) -> Hypotheses:
        """Some of the hypotheses, by index or by mask."""
        return Hypotheses(
            self.candidate[chosen],
            self.model[chosen],
            self.pose[chosen],
            self.parts[chosen],
            self.evidence[chosen],
            self.score[chosen],
        )

    @staticmethod
    def none() -> Hypotheses:
        """No hypothesis."""
        rows = np.empty(0, np.int64)
        pose, parts, evidence = (np.empty((0, n)) for n in (POSE, len(PARTS), len(EVIDENCE)))
        return Hypotheses(rows, rows, pose, parts, evidence, np.empty(0))

    @staticmethod
    def joined(tables: Sequence[Hypotheses]) -> Hypotheses:
        """All hypotheses of several tables, in order."""
        return Hypotheses(
            np.concatenate([t.candidate for t in tables]),
            np.concatenate([t.model for t in tables]),
            np.concatenate([t.pose for t in tables]),
            np.concatenate([t.parts for t in tables]),
            np.concatenate([t.evidence for t in tables]),
            np.concatenate([t.score for t in tables]),
        )


class Examiner:
    """Tries candidates as instances of known objects in a cloud of given sampling."""

    def __init__(self, objects: Sequence[KnownObject], sampling: Sampling) -> None:
        self.objects = tuple(objects)
        self.sampling = sampling
        self.limits: tuple[Tolerance, ...] = tuple(
            tolerance(o.field, o.stretch, sampling.spacing_m, sampling.noise_m) for o in objects
        )
        self.shell = tuple(
            shell_share(o.field, t.gate_m) for o, t in zip(objects, self.limits, strict=True)
        )
        self.ground_reach_m = 1.4 * max(o.field.reach_m * (1 + o.stretch) for o in objects)

    @property
    def reach_m(self) -> float:
        """How far from a candidate points matter to it."""
        far = (
            o.field.reach_m * (1 + o.stretch) + 2 * t.offset_m + 3 * t.coarse_gate_m
            for o, t in zip(self.objects, self.limits, strict=True)
        )
        return max(far) + self.ground_reach_m

    def examine(self, points: NDArray[np.floating], places: F64, threads: int) -> Hypotheses:
        """All hypotheses about candidates, given the points within ``reach_m`` of them.

        Parameters
        ----------
        points : (N, 3) world.
        places : (C, 3) world, where the topmost point of an instance may be.
        threads : how many the kernels may use; the result is the same.
        """
        if len(points) == 0:
            return Hypotheses.none()
        scene = build_surroundings(points, self.sampling, self.ground_reach_m)
        first = self._first_look(scene, places, threads)
        second = self._second_look(scene, first, threads)
        return Hypotheses.joined([first, second])

    def _first_look(self, scene: Surroundings, places: F64, threads: int) -> Hypotheses:
        poses, gains, model = [], [], []
        for m, (known, limits) in enumerate(zip(self.objects, self.limits, strict=True)):
            pose, gain = coarse_poses(scene, known.field, limits, places, COARSE, threads)
            poses.append(pose)
            gains.append(gain)
            model.append(np.full(gain.shape, m))
        pose, gain = np.concatenate(poses, axis=1), np.concatenate(gains, axis=1)
        rows = np.concatenate(model, axis=1)
        # the best of all models, and of every model its own best if that is half as good
        rank = np.argsort(np.argsort(-gain, axis=1, kind="stable"), axis=1, kind="stable")
        own_best = np.tile(np.arange(COARSE) == 0, len(self.objects))
        promising = own_best & (gain > 0.5 * gain.max(axis=1, keepdims=True))
        candidate, column = np.nonzero((gain > 0) & ((rank < STARTS) | promising))
        chosen = (candidate, column)
        return self._refined(scene, candidate, rows[chosen], pose[chosen], threads)

    def _second_look(self, scene: Surroundings, first: Hypotheses, threads: int) -> Hypotheses:
        best = first.rows(_best_rows(first))
        best = best.rows(best.score >= WORTH_A_SECOND_LOOK)
        distinct = resolve(best.pose[:, :4], self.sizes(best), best.score, max_overlap=0.5) < 0
        best = best.rows(distinct)
        candidate, model, pose = [], [], []
        for m, known in enumerate(self.objects):
            size = self.sizes(best)
            tall = np.clip(size[:, 2] / known.field.size[2], 1 - known.stretch, 1 + known.stretch)
            for quarter in range(4):
                start = np.ones_like(best.pose)
                start[:, :3] = best.pose[:, :3]
                start[:, 3] = best.pose[:, 3] + quarter * math.pi / 2
                start[:, 6] = tall
                candidate.append(best.candidate)
                model.append(np.full(len(best.pose), m))
                pose.append(start)
        return self._refined(
            scene,
            np.concatenate(candidate),
            np.concatenate(model),
            np.concatenate(pose),
            threads,
        )

    def _refined(
        self, scene: Surroundings, candidate: I64, model: I64, start: F64, threads: int
    ) -> Hypotheses:
        """Hypotheses refined from their starts and scored."""
        pose = start.copy()
        evidence = np.zeros((len(start), len(EVIDENCE)))
        parts = np.zeros((len(start), len(PARTS)))
        for m, (known, limits) in enumerate(zip(self.objects, self.limits, strict=True)):
            rows = np.flatnonzero(model == m)
            if len(rows) == 0:
                continue
            pose[rows], evidence[rows] = refine_poses(
                scene, known.field, limits, start[rows], threads
            )
            above = pose[rows, 2] - scene.ground_at(pose[rows, :2])
            height = known.field.size[2] * pose[rows, 6]
            parts[rows] = score_parts(evidence[rows], limits, self.shell[m], above, height)
        return Hypotheses(candidate, model, pose, parts, evidence, score(parts))

    def sizes(self, table: Hypotheses) -> F64:
        """(S, 3) fitted extents of hypotheses."""
        extents = np.array([o.field.size for o in self.objects])
        return extents[table.model] * table.pose[:, 4:7]


def verify_candidates(
    points: NDArray[np.floating],
    objects: Sequence[KnownObject],
    places: F64,
    sampling: Sampling,
    rules: Rules,
    threads: int = 1,
    block_m: float = 40.0,
) -> list[Verdict]:
    """Decide about every candidate of a cloud that is held in memory.

    Parameters
    ----------
    points : (N, 3) world, metres.
    objects : the models to look for.
    places : (C, 3) candidates, world.
    sampling : of the cloud, see ``measure_sampling``.
    rules : when to accept.
    threads : never changes the result.
    block_m : candidates are worked on in squares of this side, with the points they need.

    Returns
    -------
    list of Verdict, one for each candidate, in order.
    """
    examiner = Examiner(objects, sampling)
    places = np.asarray(places, dtype=np.float64).reshape(-1, 3)
    tables = []
    for rows in blocks(places, block_m):
        low = places[rows, :2].min(axis=0) - examiner.reach_m
        high = places[rows, :2].max(axis=0) + examiner.reach_m
        near = np.all((points[:, :2] >= low) & (points[:, :2] <= high), axis=1)
        table = examiner.examine(points[near], places[rows], threads)
        tables.append(
            Hypotheses(
                rows[table.candidate],
                table.model,
                table.pose,
                table.parts,
                table.evidence,
                table.score,
            )
        )
    if not tables:
        return []
    return decide(examiner, Hypotheses.joined(tables), places, rules)


def blocks(places: F64, block_m: float) -> Iterator[I64]:
    """Rows of the candidates of each occupied square, squares in order."""
    square = np.floor(places[:, :2] / block_m).astype(np.int64)
    _, number = np.unique(square, axis=0, return_inverse=True)
    number = number.ravel()
    for k in range(int(number.max(initial=-1)) + 1):
        yield np.flatnonzero(number == k)


def _best_rows(table: Hypotheses) -> I64:
    """Row of the best hypothesis of each candidate that has any."""
    order = np.lexsort((-table.score, table.candidate))
    fresh = np.r_[True, np.diff(table.candidate[order]) != 0][: len(order)]
    return order[fresh]


def decide(examiner: Examiner, table: Hypotheses, places: F64, rules: Rules) -> list[Verdict]:
    """The verdict on every candidate, given all hypotheses."""
    best = table.rows(_best_rows(table))
    displaced_by = resolve(best.pose[:, :4], examiner.sizes(best), best.score)
    verdicts: list[Verdict] = []
    position = {int(c): k for k, c in enumerate(best.candidate)}
    sizes = examiner.sizes(best)
    for candidate in range(len(places)):
        k = position.get(candidate)
        if k is None:
            verdicts.append(_nothing_there(candidate, places[candidate]))
            continue
        rivals = table.rows(table.candidate == candidate)
        margin, runner_up, runner_up_rms_m = _heading_margin(examiner, best, k, rivals)
        alternative, lead = _alternative(best, k, rivals)
        evidence: dict[str, float] = dict(zip(EVIDENCE, best.evidence[k].tolist(), strict=True))
        parts: dict[str, float] = dict(zip(PARTS, best.parts[k].tolist(), strict=True))
        fate, reason = _fate(
            examiner.objects[int(best.model[k])], evidence, parts, float(best.score[k]), rules
        )
        rival = int(displaced_by[k])
        if rival >= 0:
            fate = "rejected"
            reason = (
                f"overlaps candidate {best.candidate[rival]}, which explains the place better: "
                f"score {best.score[rival]:.2f} against {best.score[k]:.2f}"
            )
        elif fate == "accepted" and margin < rules.min_margin:
            fate = "ambiguous"
            reason = f"heading: another one scores only {margin:.3f} less"
        elif fate == "accepted" and alternative >= 0 and lead < rules.min_margin:
            other = examiner.objects[alternative].field.name
            if examiner.objects[int(best.model[k])].stretch == 0:
                fate = "ambiguous"
                reason = f"type: {other} scores only {lead:.3f} less"
        verdicts.append(
            Verdict(
                candidate=candidate,
                model=int(best.model[k]),
                pose=best.pose[k],
                size_m=sizes[k],
                parts=parts,
                evidence=evidence,
                score=float(best.score[k]),
                fate=fate,
                reason=reason,
                heading_margin=margin,
                runner_up=runner_up,
                runner_up_rms_m=runner_up_rms_m,
                alternative=alternative,
                alternative_margin=lead,
            )
        )
    return verdicts


def _nothing_there(candidate: int, place: F64) -> Verdict:
    pose = np.array([place[0], place[1], place[2], 0.0, 1.0, 1.0, 1.0])
    return Verdict(
        candidate, 0, pose, np.zeros(3), {}, {}, 0.0, "rejected",
        "no surface above the ground that any model could explain", 0.0, pose, math.inf, -1, 0.0,
    )  # fmt: skip


def _fate(
    known: KnownObject,
    evidence: dict[str, float],
    parts: dict[str, float],
    value: float,
    rules: Rules,
) -> tuple[Fate, str]:
    observed = evidence["supported"] + evidence["contradicted"]
    if value < rules.min_score:
        weakest = min(parts, key=lambda name: parts[name])
        return "rejected", (
            f"score {value:.2f} below {rules.min_score:g}; weakest part: "
            f"{weakest} {parts[weakest]:.2f}"
        )
    if observed < rules.min_observed:
        return "rejected", f"only {observed:.0%} of its visible surface was observed"
    if known.visible_from == "above" and evidence["sheltered"] > rules.max_sheltered:
        return "ambiguous", (
            f"{evidence['sheltered']:.0%} of it lies below something else, "
            "but the model is declared visible from above"
        )
    return "accepted", f"score {value:.2f}, {evidence['supported']:.0%} of its surface seen"


def _heading_margin(
    examiner: Examiner, best: Hypotheses, k: int, rivals: Hypotheses
) -> tuple[float, F64, float]:
    """How much better the heading is than the best other one of the same model."""
    known = examiner.objects[int(best.model[k])]
    turn = np.angle(np.exp(1j * (rivals.pose[:, 3] - best.pose[k, 3])))
    shift = np.hypot(*(rivals.pose[:, :2] - best.pose[k, :2]).T)
    other = (rivals.model == best.model[k]) & (np.abs(turn) > math.pi / 6)
    other &= shift < known.field.narrow_m
    for row in np.flatnonzero(other)[np.argsort(-rivals.score[other], kind="stable")]:
        if not known.field.looks_same(float(turn[row]), examiner.sampling.noise_m):
            lead = float(best.score[k] - rivals.score[row])
            return lead, rivals.pose[row], float(rivals.evidence[row, EVIDENCE.index("rms_m")])
    return float(best.score[k]), best.pose[k], math.inf


def _alternative(best: Hypotheses, k: int, rivals: Hypotheses) -> tuple[int, float]:
    """The next best model, and by how much the best one leads."""
    others = np.flatnonzero(rivals.model != best.model[k])
    if len(others) == 0:
        return -1, float(best.score[k])
    row = others[np.argmax(rivals.score[others])]
    return int(rivals.model[row]), float(best.score[k] - rivals.score[row])
