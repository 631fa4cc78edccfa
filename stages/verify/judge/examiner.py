"""Every candidate is tried as every model: a first look, and a second one where it is worth it.

The best coarse hypotheses are refined, scored and thinned to distinct places; there all models and
four headings compete again from the place found. Once the error of the scene's surfaces is known,
what was found is judged anew.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F64, I64, Mask
from spinpipe.stages.geometry.frames import inverse, transform
from spinpipe.stages.geometry.support import (
    BASE_SLACK,
    reach_of,
    support_halo_m,
)
from spinpipe.stages.threads import map_threads
from spinpipe.stages.verify.evidence.outline import GOES_ON, SIDES
from spinpipe.stages.verify.fit.coarse_bounds import has_long_top
from spinpipe.stages.verify.judge.block import Block, first_around
from spinpipe.stages.verify.judge.examination import Examination
from spinpipe.stages.verify.judge.hypotheses import (
    Course,
    T_world_object,
    coarse_poses,
    course_of,
    refine_poses,
)
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.judge.kernels import reach
from spinpipe.stages.verify.judge.resolve import resolve
from spinpipe.stages.verify.judge.scoring import PARTS, score_parts
from spinpipe.stages.verify.judge.standards import WORTH_A_SECOND_LOOK, Standards
from spinpipe.stages.verify.scene.cell_grid import CellGrid

STARTS = 3
"""How many coarse poses of a candidate are refined; twice as many where it may lie anywhere along
the top of a long object."""
LONG = 1.5
"""Length over width from which a quarter turn brings no model near itself."""
LIKELY = 0.0
"""Log odds from which a fit explains other candidates at a first look, and the like of its model
are not tried: there all compete later. Where it does not fit they may; at -12 one car of 31 on a
roof deck was lost."""
WORTH_ANOTHER_PLACE = -6.0
"""Log odds from which a candidate is examined elsewhere than where it fits best, if another one
stands there: chosen, few hypotheses gain more from a second look."""


class Examiner:
    """Tries candidates as instances of known objects."""

    def __init__(self, standards: Standards) -> None:
        objects = standards.objects
        self.standards = standards
        self.objects, self.sampling, self.limits = objects, standards.sampling, standards.limits
        self.fields = tuple(o.field for o in objects)
        self.stretch = np.array([o.stretch for o in objects])
        self.height_m = np.array([o.field.size[2] for o in objects])
        self.top_level_m = np.array([f.top_level for f in self.fields])
        self.starts = tuple(STARTS * (2 if has_long_top(f) else 1) for f in self.fields)
        self.support_reach_m = reach_of(max(o.field.reach_m * (1 + o.stretch) for o in objects))

        self.scene_m: tuple[float, ...] = tuple(
            reach(f, t) + 2 * t.coarse_gate_m for f, t in zip(self.fields, self.limits, strict=True)
        )
        """How far from a candidate the points of each model and of what touches it lie."""

    @property
    def reach_m(self) -> float:
        """How far from a candidate points matter to it."""
        return max(*self.scene_m, support_halo_m(self.sampling, self.support_reach_m))

    def look(
        self, points: NDArray[np.floating], places: F64, proposed: I64, threads: int
    ) -> Hypotheses:
        """Hypotheses about candidates as what proposed them, given the points within ``reach_m``.

        In turns: the first around, then those around it that no likely fit explains; what one
        explains is refined from there.

        Parameters
        ----------
        points : (N, 3) world.
        places : (C, 3) world, where the top of an instance may be.
        proposed : (C,) as which model each was proposed.
        threads : how many the kernels may use; the result is the same.
        """
        if len(points) == 0:
            return Hypotheses.none()
        block = self.block(points, places, proposed)
        reach_m = np.array([field.reach_m for field in self.fields])[proposed]
        looks = Hypotheses.none()
        waiting = np.arange(len(places))
        while len(waiting):
            first = first_around(places[waiting], reach_m[waiting])
            turn, waiting = waiting[first], waiting[~first]
            jobs = [(int(c), int(proposed[c])) for c in turn]
            seen = list(map_threads(lambda job: self._look(block, *job), jobs, threads))
            looks = Hypotheses.joined([looks, *seen])
            best = Hypotheses.joined(seen)
            best = best.rows(best.best_rows())
            for fit in np.flatnonzero(best.odds >= LIKELY).tolist():
                known = self._explains(
                    best.rows(np.array([fit])), places[waiting], proposed[waiting]
                )
                copies = best.rows(np.full(np.count_nonzero(known), fit))
                # each stands on what is below itself: the first one's support may be a worse one
                again = self._refined(block, waiting[known], copies.model, copies.pose, threads)
                looks = Hypotheses.joined([looks, again])
                waiting = waiting[~known]
        return Hypotheses.joined([looks, self._handed_over(block, looks, places, threads)])

    def _handed_over(
        self, block: Block, table: Hypotheses, places: F64, threads: int
    ) -> Hypotheses:
        """Fits that another candidate (C, 3) lies nearer to than the one that led there, as its.

        In rows candidates slide to their neighbours: whoever finds a place, it is found, and
        refined on what the nearest one stands on.
        """
        good = table.rows(table.odds >= WORTH_ANOTHER_PLACE)
        good = good.rows(resolve(good.upright, self.standards.sizes(good), good.odds) < 0)
        nearest = good.candidate.copy()
        for k, m in enumerate(good.model.tolist()):
            on_model, near = self._on_surface(good, k, places)
            off = np.linalg.norm(on_model[:, :2] - self.fields[m].top, axis=1)
            off[~near] = np.inf
            if near.any():
                nearest[k] = off.argmin()
        given = replace(good, candidate=nearest).rows(nearest != good.candidate)
        again = self._refined(block, given.candidate, given.model, given.pose, threads)
        return Hypotheses.joined([given, again])

    def _look(self, block: Block, c: int, m: int) -> Hypotheses:
        """Hypotheses about a candidate as a model."""
        place = block.places[c]
        scene = place.scene(block.grid, self.scene_m[m])
        pose, gain = coarse_poses(scene, self.fields[m], self.limits[m], place.top, self.starts[m])
        pose = pose[gain > 0]
        seen = self._judged(block, scene, c, np.full(len(pose), m), pose)
        if len(pose) == 0 or seen.odds.max() >= LIKELY:
            return seen
        like = self._like(m, place.top)
        start = np.repeat(pose[:1], len(like), axis=0)
        return Hypotheses.joined([seen, self._judged(block, scene, c, like, start)])

    def _explains(self, fit: Hypotheses, places: F64, proposed: I64) -> Mask:
        """Whether candidates lie on the surface of a fit of their model, well inside a long top."""
        m = int(fit.model[0])
        field, gate_m = self.fields[m], self.limits[m].gate_m
        on_model, near = self._on_surface(fit, 0, places)
        inside = (np.abs(on_model[:, :2]) < field.size[:2] / 2 - gate_m).all(axis=1)
        return (proposed == m) & inside & near & has_long_top(field)

    def _on_surface(self, table: Hypotheses, k: int, places: F64) -> tuple[F64, Mask]:
        """Places (C, 3) in the object frame of a fit, and whether each is on its surface."""
        m = int(table.model[k])
        on_model = transform(inverse(T_world_object(table.pose[k], table.lean[k])), places)
        return on_model, self.fields[m].distances(on_model) < self.limits[m].gate_m

    def examine(
        self,
        points: NDArray[np.floating],
        places: F64,
        proposed: I64,
        best: Hypotheses,
        threads: int,
    ) -> Examination:
        """All hypotheses about candidates, given the best one of a look at each.

        That is refined again, as the error may be another one now; at distinct places that may hold
        an instance all models and headings compete.
        """
        if len(points) == 0 or len(best.model) == 0:
            return Examination(Hypotheses.none(), {})
        block = self.block(points, places, proposed)
        again = self._refined(block, best.candidate, best.model, best.pose, threads)
        table = Hypotheses.joined([again, self._rivals(block, again, threads)])
        table = Hypotheses.joined([table, self._farther_on(block, table, threads)])
        table = Hypotheses.joined([table, self._handed_over(block, table, places, threads)])
        return Examination(table, self._courses(block, table))

    def block(self, points: NDArray[np.floating], places: F64, proposed: I64) -> Block:
        """Where each of some candidates stands, given the points around."""
        height = self.top_level_m[proposed]
        slack = BASE_SLACK * height + self.stretch[proposed] * height + 3 * self.sampling.noise_m
        least_m = 0.5 * float(self.height_m.min())
        return Block.of(points, places, height, slack, self.sampling, self.support_reach_m, least_m)

    def _rivals(self, block: Block, found: Hypotheses, threads: int) -> Hypotheses:
        """All models, at all plausible headings, from distinct places that are promising."""
        found = found.rows(found.odds >= WORTH_A_SECOND_LOOK)
        distinct = (
            resolve(found.upright, self.standards.sizes(found), found.odds, max_overlap=0.5) < 0
        )
        found = found.rows(distinct)
        size = self.standards.sizes(found)
        candidate, model, pose = [], [], []
        for m, known in enumerate(self.objects):
            wanted = size[:, 2] / known.field.size[2]
            slack = known.stretch + BASE_SLACK
            fits = np.flatnonzero((wanted > 1 - slack) & (wanted < 1 + slack))
            tall = np.clip(wanted[fits], 1 - known.stretch, 1 + known.stretch)
            for quarter in self._quarters(m):
                start = np.ones((len(fits), found.pose.shape[1]))
                start[:, :3] = found.base[fits]
                start[:, 3] = found.yaw[fits] + quarter * math.pi / 2
                start[:, 6] = tall
                candidate.append(found.candidate[fits])
                model.append(np.full(len(fits), m))
                pose.append(start)
        return self._refined(
            block, np.concatenate(candidate), np.concatenate(model), np.concatenate(pose), threads
        )

    def _farther_on(self, block: Block, table: Hypotheses, threads: int) -> Hypotheses:
        """Likely fits of rigid models half their extent farther on where a level body goes on.

        In a part of a larger body the model fits there as well, beside a body that it touches not.
        """
        fits = table.rows(table.best_rows())
        levels = fits.measured(*(f"{side}_level" for side in SIDES))
        rigid = (fits.odds >= LIKELY) & (self.stretch[fits.model] == 0)
        rows, sides = np.nonzero((levels >= GOES_ON) & rigid[:, None])
        start = fits.pose[rows]
        for k, (row, side) in enumerate(zip(rows, sides, strict=True)):
            T = T_world_object(fits.pose[row], fits.lean[row])
            axis, sign = side % 2, 1.0 if side < 2 else -1.0
            start[k, :3] += T[:3, axis] * sign * self.fields[fits.model[row]].size[axis] / 2
        return self._refined(block, fits.candidate[rows], fits.model[rows], start, threads)

    def _like(self, m: int, top_m: float) -> I64:
        """Other models that may stretch and be as high as a candidate is above its support."""
        wanted = top_m / self.top_level_m
        slack = self.stretch + BASE_SLACK
        fits = (self.stretch > 0) & (wanted > 1 - slack) & (wanted < 1 + slack)
        fits[m] = False
        return np.flatnonzero(fits & (self.stretch[m] > 0))

    def _quarters(self, m: int) -> tuple[int, ...]:
        """Quarter turns that may be mistaken for each other: of a long one only end for end."""
        length, width = self.objects[m].field.size[:2]
        return (0, 2) if max(length, width) > LONG * min(length, width) else (0, 1, 2, 3)

    def _refined(
        self, block: Block, candidate: I64, model: I64, start: F64, threads: int
    ) -> Hypotheses:
        """Hypotheses refined from their starts (S, 7), world, and scored."""
        order = np.argsort(candidate, kind="stable")
        owners, first = np.unique(candidate[order], return_index=True)
        groups = np.split(order, first[1:]) if len(owners) else []

        def judge(group: I64) -> Hypotheses:
            c = int(candidate[group[0]])
            place = block.places[c]
            scene = place.scene(block.grid, max(self.scene_m))
            return self._judged(block, scene, c, model[group], place.from_world(start[group]))

        return Hypotheses.joined(list(map_threads(judge, groups, threads)))

    def _judged(
        self, block: Block, scene: CellGrid, candidate: int, model: I64, start: F64
    ) -> Hypotheses:
        """Hypotheses about one candidate, refined from starts in the frame of its support."""
        place, standards = block.places[candidate], self.standards
        pose = np.ones_like(start)
        evidence, parts = None, np.zeros((len(start), len(PARTS)))
        for m in np.unique(model).tolist():
            rows = np.flatnonzero(model == m)
            limits = self.limits[m]
            pose[rows], found = refine_poses(scene, self.fields[m], limits, start[rows])
            evidence = np.zeros((len(start), found.shape[1])) if evidence is None else evidence
            evidence[rows] = found
            above = pose[rows, 2] if block.found[candidate] else np.full(len(rows), np.inf)
            height = self.height_m[m] * pose[rows, 6]
            parts[rows] = score_parts(
                found, limits, standards.shell[m], standards.right[m].points, above, height
            )
        if evidence is None:
            return Hypotheses.none()
        return Hypotheses(
            candidate=np.full(len(model), candidate),
            model=model,
            start=place.to_world(start),
            pose=place.to_world(pose),
            lean=np.tile(place.lean, (len(model), 1)),
            parts=parts,
            evidence=evidence,
            odds=(odds := self.standards.log_odds(parts, model)),
            alone=odds,
        )

    def _courses(self, block: Block, table: Hypotheses) -> dict[int, list[Course]]:
        """Of the best hypothesis of each candidate, and of what it may stand for instead."""
        rows = np.union1d(table.best_rows(), self.standards.chosen_rows(table, WORTH_ANOTHER_PLACE))
        courses: dict[int, list[Course]] = {}
        for k in rows[table.odds[rows] >= WORTH_A_SECOND_LOOK].tolist():
            m, c = int(table.model[k]), int(table.candidate[k])
            place = block.places[c]
            scene = place.scene(block.grid, max(self.scene_m))
            start = place.from_world(table.start[[k]])[0]
            way = course_of(scene, self.fields[m], self.limits[m], start)
            courses.setdefault(c, []).append(Course(place.to_world(way.poses), way.rms_m))
        return courses
