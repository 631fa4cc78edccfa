"""What is shown as seen and explained is what was judged so."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.drawing.closeup import EXPLAINED, SEEN, UNEXPLAINED, closeups
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import DETECTIONS
from spinpipe.stages.verify.judge.scoring import ODDS

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
