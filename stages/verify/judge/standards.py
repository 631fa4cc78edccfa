"""What hypotheses are judged by: the objects, how far surfaces may be off, what right ones get."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F64, I64
from spinpipe.schemas.records import Part, Sampling
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.judge.reference import Reference, right_instance
from spinpipe.stages.verify.judge.resolve import resolve
from spinpipe.stages.verify.judge.scoring import PARTS, log_odds, merits
from spinpipe.stages.verify.judge.tolerance import Tolerance, shell_share, tolerance
from spinpipe.stages.verify.model.known_object import KnownObject

WORTH_A_SECOND_LOOK = -12.0
"""Log odds from which a place is tried with all models and headings."""


@dataclass(frozen=True, eq=False)
class Standards:
    """Of known objects in a cloud of given sampling and error, one of each for every object."""

    objects: tuple[KnownObject, ...]
    sampling: Sampling
    error_m: tuple[float, ...]
    """How far surfaces are off at the object's size."""
    limits: tuple[Tolerance, ...]
    shell: tuple[float, ...]
    """See ``shell_share``."""
    right: tuple[Reference, ...]

    @classmethod
    def of(
        cls, objects: Sequence[KnownObject], sampling: Sampling, error_m: Sequence[float]
    ) -> Standards:
        """Make and judge right instances."""
        limits = tuple(
            tolerance(o.field, o.stretch, sampling, error)
            for o, error in zip(objects, error_m, strict=True)
        )
        shell = tuple(shell_share(o.field, t.gate_m) for o, t in zip(objects, limits, strict=True))
        right = tuple(
            right_instance(o.field, t, sampling, error, share)
            for o, t, error, share in zip(objects, limits, error_m, shell, strict=True)
        )
        return cls(tuple(objects), sampling, tuple(error_m), limits, shell, right)

    @property
    def reference(self) -> F64:
        """(objects, len(PARTS)) what right instances get."""
        return np.array([right.parts for right in self.right])

    def log_odds(self, parts: F64, model: I64) -> F64:
        """Log odds (S,) of parts (S, len(PARTS)) of hypotheses about models (S,)."""
        return log_odds(parts, self.reference[model])

    def parts_of(self, parts: F64, model: int) -> tuple[Part, ...]:
        """Parts (len(PARTS),) of a hypothesis about a model beside what a right instance gets."""
        reference = self.reference[model]
        merit = merits(parts[None], reference[None])[0]
        rows = zip(PARTS, parts.tolist(), reference.tolist(), merit.tolist(), strict=True)
        return tuple(Part(*row) for row in rows)

    def chosen_rows(self, table: Hypotheses, least_odds: float) -> I64:
        """Row of the hypothesis that each candidate stands for, by candidate.

        The best one; where a better one of another candidate already stands there, the next one
        that is good enough in itself: candidates in a row slide to their neighbours.
        """
        chosen = table.best_rows()
        rows = np.flatnonzero(table.odds >= least_odds)
        good = table.rows(rows)
        poses, sizes = good.upright, self.sizes(good)
        apart = rows[resolve(poses, sizes, good.rank, candidate=good.candidate) < 0]
        chosen[np.searchsorted(table.candidate[chosen], table.candidate[apart])] = apart
        return chosen

    def sizes(self, table: Hypotheses) -> F64:
        """(S, 3) fitted extents of hypotheses."""
        extents = np.array([o.field.size for o in self.objects])
        return extents[table.model] * table.stretch
