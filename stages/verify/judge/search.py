"""All candidates of a run, block by block: a look at each, the error measured, then all rivals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from spinpipe.schemas.arrays import F32, F64, I64
from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.verify.judge.block import blocks
from spinpipe.stages.verify.judge.errors import measured_errors
from spinpipe.stages.verify.judge.examiner import (
    WORTH_ANOTHER_PLACE,
    Examination,
    Examiner,
)
from spinpipe.stages.verify.judge.hypotheses import Course
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.judge.standards import Standards
from spinpipe.stages.verify.judge.tolerance import greatest_error_m
from spinpipe.stages.verify.model.known_object import KnownObject

MapBlocks: TypeAlias = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]
"""Maps a function over items, in order."""

BLOCK_REACHES = 2.0
"""Side of a block of candidates, in reaches: it follows from the models alone, because candidates
of one block are thinned together."""

GLANCE = 3
"""A first look probes one in so many places of a model; what it finds is judged again by all."""


@dataclass(frozen=True, eq=False)
class Found:
    """All hypotheses about all candidates, and by which tolerances they were judged."""

    standards: Standards
    table: Hypotheses
    courses: dict[int, list[Course]]


@dataclass(frozen=True)
class _Task:
    """What a worker needs to work on any block; can be pickled."""

    examiner: Examiner
    cloud: WorldCloud
    places: F64
    proposed: I64
    threads: int

    def points(self, rows: I64) -> F32:
        """What lies around the candidates of a block."""
        places = self.places[rows]
        reach = np.array([self.examiner.reach_m, self.examiner.reach_m, np.inf])
        return self.cloud.inside(places.min(axis=0) - reach, places.max(axis=0) + reach)


@dataclass(frozen=True, eq=False)
class Search:
    """What to look for, and where.

    ``places`` (C, 3) are the candidates, world; ``proposed`` (C,) as which object each was
    proposed; ``threads`` never changes a result.
    """

    objects: Sequence[KnownObject]
    sampling: Sampling
    cloud: WorldCloud
    places: F64
    proposed: I64
    threads: int

    def run(
        self, error_m: float | None, map_blocks: MapBlocks, advance: Callable[[int], None]
    ) -> Found:
        """All hypotheses.

        Parameters
        ----------
        error_m : of the surfaces of instances; None: measured on what a look at all finds.
        map_blocks : maps a function over blocks of candidates, in order.
        advance : told how many more candidates are looked at, each of them twice.
        """
        most = [greatest_error_m(o.field) for o in self.objects]
        glanced = [replace(o, field=o.field.glanced(GLANCE)) for o in self.objects]
        standards = Standards.of(glanced, self.sampling, most)
        examiner = Examiner(standards)
        rows_of_blocks = list(blocks(self.places, BLOCK_REACHES * examiner.reach_m))
        looks: list[Hypotheses] = []
        for rows, seen in zip(
            rows_of_blocks,
            map_blocks(partial(_look, self._task(examiner)), rows_of_blocks),
            strict=True,
        ):
            looks.append(replace(seen, candidate=rows[seen.candidate]))
            advance(len(rows))
        first = Hypotheses.joined(looks)
        first = first.rows(standards.chosen_rows(first, WORTH_ANOTHER_PLACE))
        errors = measured_errors(standards, first) if error_m is None else [error_m] * len(most)
        standards = Standards.of(self.objects, self.sampling, errors)
        jobs = self._by_block(first, rows_of_blocks)
        tables: list[Hypotheses] = []
        courses: dict[int, list[Course]] = {}
        examined = map_blocks(partial(_examine, self._task(Examiner(standards))), jobs)
        for (rows, _), seen in zip(jobs, examined, strict=True):
            tables.append(replace(seen.table, candidate=rows[seen.table.candidate]))
            courses |= {int(rows[k]): course for k, course in seen.courses.items()}
            advance(len(rows))
        return Found(standards, Hypotheses.joined(tables), courses)

    def _by_block(
        self, best: Hypotheses, rows_of_blocks: list[I64]
    ) -> list[tuple[I64, Hypotheses]]:
        """The rows of each block with its hypotheses, numbered within the block."""
        rows_of = best.rows_of_candidates(len(self.places))
        jobs: list[tuple[I64, Hypotheses]] = []
        for rows in rows_of_blocks:
            own = best.rows(np.concatenate([rows_of[c] for c in rows]))
            jobs.append((rows, replace(own, candidate=np.searchsorted(rows, own.candidate))))
        return jobs

    def _task(self, examiner: Examiner) -> _Task:
        return _Task(examiner, self.cloud, self.places, self.proposed, self.threads)


def _look(task: _Task, rows: I64) -> Hypotheses:
    """Hypotheses about the candidates of one block, as what proposed them."""
    return task.examiner.look(
        task.points(rows), task.places[rows], task.proposed[rows], task.threads
    )


def _examine(task: _Task, job: tuple[I64, Hypotheses]) -> Examination:
    """All hypotheses about the candidates of one block."""
    rows, best = job
    return task.examiner.examine(
        task.points(rows), task.places[rows], task.proposed[rows], best, task.threads
    )
