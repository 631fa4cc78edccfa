"""The parts of a right instance: less in a worse cloud, the same at every call."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.shapes import Mesh, sample_surface
from spinpipe.stages.ingest.vehicles import vehicle_mesh
from spinpipe.stages.verify.judge.reference import LEAST, right_instance
from spinpipe.stages.verify.judge.tolerance import shell_share, tolerance
from spinpipe.stages.verify.model.field import build_model_field


def reference(spacing_m: float, noise_m: float, error_m: float = 0.0) -> NDArray[np.float64]:
    mesh = Mesh(*vehicle_mesh("saloon"))
    field = build_model_field("car", *sample_surface(*mesh, 30_000, np.random.default_rng(0)))
    sampling = Sampling(spacing_m, noise_m)
    limits = tolerance(field, 0.0, sampling, error_m)
    shell = shell_share(field, limits.gate_m)
    return right_instance(field, limits, sampling, error_m, shell).parts


def test_noise_lowers_what_can_be_asked_for() -> None:
    clean, noisy, drowned = reference(0.1, 0.0), reference(0.1, 0.1), reference(0.1, 0.6)
    assert (clean <= 1.0).all()
    assert (drowned >= LEAST).all()
    assert clean.prod() > noisy.prod() > drowned.prod()
    assert clean.prod() > 0.7


def test_error_at_the_size_of_the_object_lowers_it_too() -> None:
    assert reference(0.1, 0.0).prod() > reference(0.1, 0.0, 0.1).prod() > 0.2


def test_it_is_no_matter_of_chance() -> None:
    assert np.array_equal(reference(0.15, 0.03), reference(0.15, 0.03))
