"""What looks at candidates find, and how it travels in a run's files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from spinpipe.schemas.arrays import I64
from spinpipe.schemas.records import BlockHypotheses
from spinpipe.stages.verify.judge.hypotheses import Course
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.model.pose import POSE

_COLUMNS = tuple(f.name for f in fields(Hypotheses) if f.name not in ("candidate", "alone"))
"""Of both; what neighbours explain is known only when all blocks are."""


@dataclass(frozen=True, eq=False)
class Examination:
    """All hypotheses about some candidates, and how those that are any good came about."""

    table: Hypotheses
    courses: dict[int, list[Course]]
    """Of the hypotheses that a candidate may stand for, by candidate."""

    def record(self, look: int, rows: I64) -> BlockHypotheses:
        """Of a block whose candidates are the ``rows`` of all."""
        ways = [(rows[c], way) for c, courses in self.courses.items() for way in courses]
        return BlockHypotheses(
            look=look,
            candidate=rows[self.table.candidate],
            course_candidate=np.array([c for c, _ in ways], np.int64),
            course_length=np.array([len(way.rms_m) for _, way in ways], np.int64),
            course_poses=np.concatenate([np.empty((0, POSE)), *(way.poses for _, way in ways)]),
            course_rms_m=np.concatenate([np.empty(0), *(way.rms_m for _, way in ways)]),
            **{name: getattr(self.table, name) for name in _COLUMNS},
        )

    @classmethod
    def of_records(cls, records: Sequence[BlockHypotheses]) -> Examination:
        """Of all blocks."""
        tables: list[Hypotheses] = []
        courses: dict[int, list[Course]] = {}
        for record in records:
            columns = {name: getattr(record, name) for name in _COLUMNS}
            tables.append(Hypotheses(candidate=record.candidate, alone=record.odds, **columns))
            ends = np.cumsum(record.course_length)
            ways = zip(record.course_candidate, ends - record.course_length, ends, strict=True)
            for c, first, past in ways:
                way = Course(record.course_poses[first:past], record.course_rms_m[first:past])
                courses.setdefault(int(c), []).append(way)
        return cls(Hypotheses.joined(tables), courses)
