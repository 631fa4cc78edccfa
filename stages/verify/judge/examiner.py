"""Every candidate is tried as every model: a first look, and a second one where it is worth it.

The best coarse hypotheses are refined, scored and thinned to distinct places; there all models and
four headings compete again from the place found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.records import Sampling
from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.judge.hypotheses import Course, coarse_poses, course_of, refine_poses
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.judge.reference import right_instance
from spinpipe.stages.verify.judge.resolve import resolve
from spinpipe.stages.verify.judge.scoring import PARTS, merits, score, score_parts
from spinpipe.stages.verify.judge.tolerance import Tolerance, shell_share, tolerance
from spinpipe.stages.verify.model.known_object import KnownObject
from spinpipe.stages.verify.scene.surroundings import Surroundings, build_surroundings

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

COARSE = 3
"""How many coarse poses of a candidate are kept for each model."""
STARTS = 5
"""How many of them are refined, over all models, at least."""
WORTH_A_SECOND_LOOK = 0.02
"""Score from which a place is tried with all models and headings."""


@dataclass(frozen=True, eq=False)
class Examination:
    """All hypotheses about some candidates, and how those that are any good came about."""

    table: Hypotheses
    courses: dict[int, Course]
    """Of the best hypothesis, by candidate."""


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
        right = [
            right_instance(o.field, t, sampling, shell)
            for o, t, shell in zip(objects, self.limits, self.shell, strict=True)
        ]
        self.reference = np.array([r.parts for r in right])
        self.expected = tuple(r.points for r in right)
        self.stretch = np.array([o.stretch for o in objects])
        self.ground_reach_m = 1.4 * max(o.field.reach_m * (1 + o.stretch) for o in objects)

    @property
    def reach_m(self) -> float:
        """How far from a candidate points matter to it."""
        far = (
            o.field.reach_m * (1 + o.stretch) + 2 * t.offset_m + 3 * t.coarse_gate_m
            for o, t in zip(self.objects, self.limits, strict=True)
        )
        return max(far) + self.ground_reach_m

    def examine(self, points: NDArray[np.floating], places: F64, threads: int) -> Examination:
        """All hypotheses about candidates, given the points within ``reach_m`` of them.

        Parameters
        ----------
        points : (N, 3) world.
        places : (C, 3) world, where the topmost point of an instance may be.
        threads : how many the kernels may use; the result is the same.
        """
        if len(points) == 0:
            return Examination(Hypotheses.none(), {})
        scene = build_surroundings(points, self.sampling, self.ground_reach_m)
        first = self._first_look(scene, places, threads)
        second = self._second_look(scene, first, threads)
        table = Hypotheses.joined([first, second])
        return Examination(table, self._courses(scene, table.rows(table.best_rows())))

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
        best = first.rows(first.best_rows())
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
            parts[rows] = score_parts(
                evidence[rows], limits, self.shell[m], self.expected[m], above, height
            )
        value = self.score(parts, model)
        return Hypotheses(candidate, model, start, pose, parts, evidence, value)

    def score(self, parts: F64, model: I64) -> F64:
        """Scores (S,) of parts (S, len(PARTS)) of hypotheses about models (S,)."""
        return score(parts, self.reference[model], self.stretch[model])

    def weakest_part(self, parts: F64, model: int) -> str:
        """Name of the part (of (len(PARTS),)) that costs a hypothesis about a model most."""
        lost = merits(parts[None], self.reference[[model]], self.stretch[[model]])[0]
        return PARTS[int(np.argmin(lost))]

    def _courses(self, scene: Surroundings, best: Hypotheses) -> dict[int, Course]:
        courses: dict[int, Course] = {}
        for k in np.flatnonzero(best.score >= WORTH_A_SECOND_LOOK):
            m = int(best.model[k])
            courses[int(best.candidate[k])] = course_of(
                scene, self.objects[m].field, self.limits[m], best.start[k]
            )
        return courses

    def sizes(self, table: Hypotheses) -> F64:
        """(S, 3) fitted extents of hypotheses."""
        extents = np.array([o.field.size for o in self.objects])
        return extents[table.model] * table.pose[:, 4:7]


def blocks(places: F64, block_m: float) -> Iterator[I64]:
    """Rows of the candidates of each occupied square, squares in order."""
    square = np.floor(places[:, :2] / block_m).astype(np.int64)
    _, number = np.unique(square, axis=0, return_inverse=True)
    number = number.ravel()
    for k in range(int(number.max(initial=-1)) + 1):
        yield np.flatnonzero(number == k)
