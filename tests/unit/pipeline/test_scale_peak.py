"""Which factor a search for the scale settles on, and when it does not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from spinpipe.pipeline.scale_peak import MOST_RIVAL, STRONG, Trial, peak, trial_of
from spinpipe.schemas.arrays import F64
from spinpipe.stages.stage import StageError

SALOON_M, BUS_M = (4.5, 1.8, 1.45), (18.2, 2.6, 3.1)
BEST = Trial(0.5, evidence=20.0, instances=4, estimate=0.501, error=0.002)


def sizes(stretches: F64, size_m: tuple[float, float, float] = SALOON_M) -> F64:
    return np.broadcast_to(size_m, stretches.shape)


def test_instances_say_how_far_off_the_factor_is() -> None:
    stretches = np.full((4, 3), 1.1) * np.array([[0.999], [1.0], [1.0], [1.001]])
    trial = trial_of(0.5, stretches, sizes(stretches), np.full(4, 5.0))
    assert trial.estimate == pytest.approx(0.5 / 1.1)
    assert (trial.instances, trial.evidence) == (4, 20.0)
    assert trial.error < 0.001


def test_other_objects_that_fit_worse_do_not_count() -> None:
    stretches = np.array([[1.0] * 3] * 3 + [[0.9] * 3] * 3 + [[0.7] * 3] * 30)
    odds = np.array([5.0] * 3 + [3.0] * 3 + [STRONG - 0.1] * 30)
    trial = trial_of(2.0, stretches, sizes(stretches), odds)
    assert trial.estimate == pytest.approx(2.0)
    assert trial.instances == 6


def test_a_model_of_other_proportions_is_no_yardstick_however_many_fit() -> None:
    rng = np.random.default_rng(0)
    stretches = np.array([1.0, 1.07, 0.9]) * rng.normal(1, 0.01, (1000, 1))
    trial = trial_of(1.0, stretches, sizes(stretches), np.full(1000, 5.0))
    assert trial.error > 0.03
    with pytest.raises(StageError, match="uncertain by"):
        peak([trial], trial)


def test_sides_are_off_by_metres_not_by_per_cent() -> None:
    """What drone photos bridge between buses widens and raises all of them by 5 and 15 cm."""
    rng = np.random.default_rng(0)
    off_m = np.array([0.0, 0.05, 0.15]) + rng.normal(0, 0.05, (20, 3))
    stretches = 1 + off_m / BUS_M
    trial = trial_of(0.6, stretches, sizes(stretches, BUS_M), np.full(20, 5.0))
    assert trial.estimate == pytest.approx(0.6, rel=0.005)
    assert trial.error < 0.01
    off_m = np.array([0.15, 0.0, 0.0]) + rng.normal(0, 0.01, (20, 3))  # of another length
    stretches = 1 + off_m / SALOON_M
    assert trial_of(0.6, stretches, sizes(stretches), np.full(20, 5.0)).error > 0.01


def test_a_distinct_peak_is_told_with_its_width() -> None:
    others = [Trial(0.4, 15.0, 4, 0.47), Trial(0.3), Trial(0.6, 12.0, 4, 0.52), Trial(0.7)]
    found = peak([BEST, *others, Trial(2.0, 9.0, 3, 2.1)], BEST)
    assert found.scale == BEST.estimate
    low = 0.4 * (0.3 / 0.4) ** (5 / 15)
    high = 0.6 * (0.7 / 0.6) ** (2 / 12)
    assert f"half as much at {low:.3g} and {high:.3g}" in found.note


def test_another_factor_with_as_much_to_say_leaves_both_in_doubt() -> None:
    rival = Trial(0.9, BEST.evidence * MOST_RIVAL * 1.01, 3, 0.88)
    with pytest.raises(StageError, match=r"no distinct factor: best 0\.501 .*, also 0\.88 "):
        peak([BEST, rival], BEST)
    near = replace(rival, factor=0.6, estimate=BEST.estimate * 1.15)
    assert peak([BEST, near], BEST).scale == BEST.estimate


def test_what_does_not_settle_is_uncertain() -> None:
    restless = replace(BEST, estimate=BEST.factor * 1.03)
    with pytest.raises(StageError, match="uncertain by"):
        peak([restless], restless)


def test_nothing_found_is_said() -> None:
    nothing = trial_of(1.0, np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    assert (nothing.instances, nothing.error) == (0, math.inf)
    with pytest.raises(StageError, match="found nothing from 1 to 1"):
        peak([nothing], nothing)
