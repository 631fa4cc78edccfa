"""Hypotheses as a table: which candidate may be which model, where, and how good that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.judge.scoring import PARTS
from spinpipe.stages.verify.model.lookup import POSE

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses as columns: which candidate, which model, from where to where, how good."""

    candidate: I64
    model: I64
    start: F64
    pose: F64
    parts: F64
    evidence: F64
    score: F64

    def rows(self, chosen: NDArray[np.integer] | NDArray[np.bool_]) -> Hypotheses:
        """Some of the hypotheses, by index or by mask."""
        return Hypotheses(
            self.candidate[chosen],
            self.model[chosen],
            self.start[chosen],
            self.pose[chosen],
            self.parts[chosen],
            self.evidence[chosen],
            self.score[chosen],
        )

    def best_rows(self) -> I64:
        """Row of the best hypothesis of each candidate that has any, by candidate."""
        order = np.lexsort((-self.score, self.candidate))
        fresh = np.r_[True, np.diff(self.candidate[order]) != 0][: len(order)]
        return order[fresh]

    def rows_of_candidates(self, count: int) -> list[I64]:
        """Rows of each of ``count`` candidates, in order."""
        order = np.argsort(self.candidate, kind="stable")
        first = np.searchsorted(self.candidate[order], np.arange(1, count))
        return np.split(order, first)

    @staticmethod
    def none() -> Hypotheses:
        """No hypothesis."""
        rows = np.empty(0, np.int64)
        pose, parts, evidence = (np.empty((0, n)) for n in (POSE, len(PARTS), len(EVIDENCE)))
        return Hypotheses(rows, rows, pose, pose, parts, evidence, np.empty(0))

    @staticmethod
    def joined(tables: Sequence[Hypotheses]) -> Hypotheses:
        """All hypotheses of several tables, in order."""
        return Hypotheses(
            np.concatenate([t.candidate for t in tables]),
            np.concatenate([t.model for t in tables]),
            np.concatenate([t.start for t in tables]),
            np.concatenate([t.pose for t in tables]),
            np.concatenate([t.parts for t in tables]),
            np.concatenate([t.evidence for t in tables]),
            np.concatenate([t.score for t in tables]),
        )
