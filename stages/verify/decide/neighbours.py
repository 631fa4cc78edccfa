"""Instances that stand close together, decided about together.

Where a neighbour stands the scene does not drop, which looks as if the body went on. What is known
to be an instance explains that, and by that others may become instances.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import logit

from spinpipe.schemas.arrays import F64, I64
from spinpipe.stages.verify.decide.continuation import explained_sides
from spinpipe.stages.verify.evidence.outline import SIDES, TOUCHED
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.judge.resolve import resolve
from spinpipe.stages.verify.judge.scoring import PARTS
from spinpipe.stages.verify.judge.standards import WORTH_A_SECOND_LOOK, Standards

ROUNDS = 4
"""Rows are explained from their ends; few are longer than twice as many."""


class Standing(NamedTuple):
    """Instances as far as is known: poses (N, 4), extents (N, 3), and which fits gave way."""

    poses: F64
    sizes: F64
    best: Hypotheses
    """What each candidate stands for, see ``Standards.chosen_rows``."""
    displaced_by: I64
    """(C,) of these, see ``resolve``."""


def standing(standards: Standards, table: Hypotheses, min_score: float) -> Standing:
    """Which candidates are instances as far as is known, given all hypotheses."""
    best = table.rows(standards.chosen_rows(table, float(logit(min_score))))
    poses, sizes = best.upright, standards.sizes(best)
    displaced_by = resolve(poses, sizes, best.rank)
    stays = (displaced_by < 0) & (best.score >= min_score)
    return Standing(poses[stays], sizes[stays], best, displaced_by)


def explain_neighbours(standards: Standards, table: Hypotheses, min_score: float) -> Hypotheses:
    """The table with the outlines that neighbours explain counted as seen, and scored again."""
    drops = table.measured(*SIDES)
    # members of a family would fit side by side into any hedge or roof, and explain each other
    known = np.array([o.rigid for o in standards.objects])[table.model]
    worth = known & (table.odds >= WORTH_A_SECOND_LOOK)
    rows = np.flatnonzero(worth & (drops < TOUCHED).any(axis=1))
    if len(rows) == 0:
        return table
    touched = table.rows(rows)
    drops, sizes = drops[rows], standards.sizes(touched)
    seen, before = table, np.zeros(0)
    for _ in range(ROUNDS):
        near = standing(standards, seen, min_score)
        explained = explained_sides(touched.upright, sizes, near.poses, near.sizes)
        hidden = ((1.0 - drops) * (explained & (drops < TOUCHED))).mean(axis=1)
        drop = np.clip(touched.measured("drop") + hidden, 0.0, 1.0)
        parts, value = table.parts.copy(), table.odds.copy()
        parts[rows, PARTS.index("outline")] = np.cbrt(drop)
        value[rows] = standards.log_odds(parts[rows], touched.model)
        seen = replace(table, parts=parts, odds=value)
        if np.array_equal(value, before):
            break
        before = value
    return seen
