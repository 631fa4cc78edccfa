"""Hypotheses as a table: which candidate may be which model, where, and how good that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from spinpipe.schemas.arrays import F64, I64, Mask
from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.judge.scoring import PARTS
from spinpipe.stages.verify.model.pose import POSE


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses as columns: which candidate, which model, from where to where, how good.

    ``start`` and ``pose`` (S, 7) are in the world; ``lean`` (S, 2) are the slopes of what the
    object stands on; ``odds`` (S,) is the logarithm of the odds that it is an instance, ``alone``
    the same without what its neighbours explain.
    """

    candidate: I64
    model: I64
    start: F64
    pose: F64
    lean: F64
    parts: F64
    evidence: F64
    odds: F64
    alone: F64

    @property
    def base(self) -> F64:
        """(S, 3) base centres, world, metres."""
        return self.pose[:, :3]

    @property
    def yaw(self) -> F64:
        """(S,) headings, radians."""
        return self.pose[:, 3]

    @property
    def upright(self) -> F64:
        """(S, 4) base centres and yaws: where bodies stand, whatever their size."""
        return self.pose[:, :4]

    @property
    def stretch(self) -> F64:
        """(S, 3) along the object's axes."""
        return self.pose[:, 4:]

    def measured(self, *names: str) -> F64:
        """Evidence by name: (S,) of one, (S, N) of several."""
        columns = [EVIDENCE.index(name) for name in names]
        return self.evidence[:, columns[0] if len(columns) == 1 else columns]

    @property
    def score(self) -> F64:
        """(S,) probabilities."""
        return np.asarray(expit(self.odds))

    @property
    def rank(self) -> F64:
        """(S,) by what the better of two is told: what neighbours explain counts half."""
        return (self.odds + self.alone) / 2

    def rows(self, chosen: NDArray[np.integer] | Mask) -> Hypotheses:
        """Some of the hypotheses, by index or by mask."""
        return Hypotheses(*(getattr(self, f.name)[chosen] for f in fields(self)))

    def best_rows(self) -> I64:
        """Row of the best hypothesis of each candidate that has any, by candidate."""
        order = np.lexsort((-self.rank, self.candidate))
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
        pose, lean, parts, evidence = (
            np.empty((0, n)) for n in (POSE, 2, len(PARTS), len(EVIDENCE))
        )
        return Hypotheses(rows, rows, pose, pose, lean, parts, evidence, np.empty(0), np.empty(0))

    @staticmethod
    def joined(tables: Sequence[Hypotheses]) -> Hypotheses:
        """All hypotheses of several tables, in order."""
        tables = tables or [Hypotheses.none()]
        names = [f.name for f in fields(Hypotheses)]
        return Hypotheses(*(np.concatenate([getattr(t, n) for t in tables]) for n in names))
