"""What is shown as seen and explained is what was judged so."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.unit.pipeline.drawn import make_detection

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.drawing.closeup import EXPLAINED, SEEN, UNEXPLAINED, closeups, worth_a_look
from spinpipe.pipeline.drawing.texts import LOW
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import DETECTIONS
from spinpipe.stages.verify.judge.scoring import ODDS, PARTS

if TYPE_CHECKING:
    from tests.conftest import YardRun


def test_shares_agree_with_the_evidence(finished_yard: YardRun) -> None:
    """Of accepted and rejected ones; pieces are told whole, so that shares differ a little."""
    read = RunReader(RunFolder(finished_yard.output))
    detections = [d for d in read(DETECTIONS) if d.parts]
    assert {d.fate for d in detections} >= {"accepted"}
    for look in closeups(read, detections, 100_000):
        d = look.detection
        assert abs(np.mean(look.sight == SEEN) - d.coverage_model) < 0.12, d
        explained = np.sum(look.what == EXPLAINED)
        judged = explained + np.sum(look.what == UNEXPLAINED)
        if d.fate == "accepted":
            assert explained / judged > d.coverage_scene - 0.1


def test_a_gate_is_told_with_every_detection(finished_yard: YardRun) -> None:
    for d in RunReader(RunFolder(finished_yard.output))(DETECTIONS):
        assert 0 < d.sharp_m <= d.gate_m < min(d.size_m)
        if d.parts:
            assert d.log_odds == pytest.approx(ODDS + sum(p.merit for p in d.parts))
            assert all(0 < p.reference <= 1 for p in d.parts)


def test_duplicates_leave_room_for_rejected_ones() -> None:
    """A town has hundreds of duplicates, all of higher odds than what was rejected."""
    fates = ["duplicate"] * 50 + ["rejected"] * 50 + ["accepted"]
    every = [
        replace(make_detection(i, "saloon", fate), log_odds=float(-i))
        for i, fate in enumerate(fates)
    ]
    chosen = worth_a_look(every, 21)
    assert [d.id for d in chosen[:3]] == [100, 50, 0]
    assert Counter(d.fate for d in chosen) == {"accepted": 1, "rejected": 10, "duplicate": 10}
    assert {d.id for d in chosen[1:]} == {*range(10), *range(50, 60)}


def test_every_part_of_a_score_has_words() -> None:
    assert set(LOW) == set(PARTS)
