"""Spacing, noise and the error of surfaces over patches of growing side."""

from __future__ import annotations

import numpy as np
import pytest

from spinpipe.schemas.arrays import F64
from spinpipe.stages.geometry.sampling import measure_sampling

SPACING_M, NOISE_M = 0.1, 0.01


def field(relief_m: float = 0.0, wave_m: float = 8.0, side_m: float = 30.0) -> F64:
    """A surface of waves of amplitude ``relief_m`` and length ``wave_m``, with noise."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, side_m, (round((side_m / SPACING_M) ** 2), 2))
    z = relief_m * np.sin(xy[:, 0] * 2 * np.pi / wave_m) + rng.normal(0, NOISE_M, len(xy))
    return np.column_stack([xy, z])


@pytest.mark.parametrize("height_m", [0.0, 12.345])
def test_a_plain_errs_by_its_noise_at_every_scale(height_m: float) -> None:
    sampling = measure_sampling(field() + (0, 0, height_m))
    assert sampling.spacing_m == pytest.approx(SPACING_M, rel=0.1)
    assert [e.side_m for e in sampling.errors] == pytest.approx([0.5, 1, 2, 4], rel=0.1)
    for error in (sampling.noise_m, *(e.error_m for e in sampling.errors)):
        assert error == pytest.approx(NOISE_M, rel=0.1)


def test_waves_show_over_patches_as_long_as_they_are() -> None:
    errors = measure_sampling(field(relief_m=0.1)).errors
    assert errors[0].error_m == pytest.approx(NOISE_M, rel=0.2)
    assert errors[-1].error_m > 3 * NOISE_M


def test_points_below_ground_and_a_ceiling_change_no_error() -> None:
    ground = field()
    rng = np.random.default_rng(1)
    below = ground[rng.random(len(ground)) < 0.02] - np.array([[0, 0, 5.0]])
    below[:, 2] -= rng.uniform(0, 20, len(below))
    errors = measure_sampling(np.concatenate([ground, below, ground + (0, 0, 3.3)])).errors
    for error in errors[:3]:
        assert error.error_m == pytest.approx(NOISE_M, rel=0.2)
