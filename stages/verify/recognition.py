"""Which candidates are instances of which model: hypotheses, evidence, competition, fate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.records import Sampling
from spinpipe.stages.verify.decide.decision import decide
from spinpipe.stages.verify.decide.verdict import Rules, Verdict
from spinpipe.stages.verify.judge.examiner import Examiner, blocks
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.model.known_object import KnownObject

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


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
    tables: list[Hypotheses] = []
    for rows in blocks(places, block_m):
        low = places[rows, :2].min(axis=0) - examiner.reach_m
        high = places[rows, :2].max(axis=0) + examiner.reach_m
        near = np.all((points[:, :2] >= low) & (points[:, :2] <= high), axis=1)
        table = examiner.examine(points[near], places[rows], threads).table
        tables.append(replace(table, candidate=rows[table.candidate]))
    if not tables:
        return []
    return decide(examiner, Hypotheses.joined(tables), places, rules)
