"""All candidates of a run, block by block: a look at each, the error measured, then all rivals."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from spinpipe.schemas.arrays import F32, F64, I64
from spinpipe.schemas.records import BlockHypotheses, Sampling
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.verify.judge.block import blocks
from spinpipe.stages.verify.judge.errors import measured_errors
from spinpipe.stages.verify.judge.examination import Examination
from spinpipe.stages.verify.judge.examiner import (
    WORTH_ANOTHER_PLACE,
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
class Store:
    """Where a run keeps what it finds in each block, and what of it an interrupted one left."""

    keep: Callable[[BlockHypotheses], None]
    recovered: Sequence[BlockHypotheses] = ()

    def of_look(self, look: int) -> list[BlockHypotheses]:
        """What was left of one look, block by block from the first on."""
        return [block for block in self.recovered if block.look == look]


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
        self,
        error_m: float | None,
        map_blocks: MapBlocks,
        store: Store,
        advance: Callable[[int], None],
    ) -> Found:
        """All hypotheses.

        Parameters
        ----------
        error_m : of the surfaces of instances; None: measured on what a look at all finds.
        map_blocks : maps a function over blocks of candidates, in order.
        store : keeps what was found.
        advance : told how many more candidates are looked at, each of them twice.
        """

        def examined(
            look: int, function: Callable[[Any], Examination], jobs: Sequence[Any]
        ) -> Examination:
            """What a look finds at all blocks."""
            found = store.of_look(look)
            known = len(found)
            advance(sum(len(rows) for rows in rows_of_blocks[:known]))
            rest = map_blocks(function, jobs[known:])
            for rows, seen in zip(rows_of_blocks[known:], rest, strict=True):
                found.append(seen.record(look, rows))
                store.keep(found[-1])
                advance(len(rows))
            return Examination.of_records(found)

        most = [greatest_error_m(o.field) for o in self.objects]
        glanced = [replace(o, field=o.field.glanced(GLANCE)) for o in self.objects]
        standards = Standards.of(glanced, self.sampling, most)
        examiner = Examiner(standards)
        rows_of_blocks = list(blocks(self.places, BLOCK_REACHES * examiner.reach_m))
        first = examined(1, partial(_look, self._task(examiner)), rows_of_blocks).table
        first = first.rows(standards.chosen_rows(first, WORTH_ANOTHER_PLACE))
        errors = measured_errors(standards, first) if error_m is None else [error_m] * len(most)
        standards = Standards.of(self.objects, self.sampling, errors)
        jobs = self._by_block(first, rows_of_blocks)
        last = examined(2, partial(_examine, self._task(Examiner(standards))), jobs)
        return Found(standards, last.table, last.courses)

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


def _look(task: _Task, rows: I64) -> Examination:
    """Hypotheses about the candidates of one block, as what proposed them."""
    table = task.examiner.look(
        task.points(rows), task.places[rows], task.proposed[rows], task.threads
    )
    return Examination(table, {})


def _examine(task: _Task, job: tuple[I64, Hypotheses]) -> Examination:
    """All hypotheses about the candidates of one block."""
    rows, best = job
    return task.examiner.examine(
        task.points(rows), task.places[rows], task.proposed[rows], best, task.threads
    )
