"""The score of a right instance: less in a worse cloud, the same at every call."""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.records import Sampling
from spinpipe.stages.model_field import build_model_field
from spinpipe.stages.reference import LEAST, reference_product
from spinpipe.stages.shapes import Mesh, sample_surface
from spinpipe.stages.tolerance import shell_share, tolerance
from spinpipe.stages.vehicles import vehicle_mesh


def reference(spacing_m: float, noise_m: float) -> float:
    mesh = Mesh(*vehicle_mesh("saloon"))
    field = build_model_field("car", *sample_surface(*mesh, 30_000, np.random.default_rng(0)))
    sampling = Sampling(spacing_m, noise_m)
    limits = tolerance(field, 0.0, spacing_m, noise_m)
    return reference_product(field, limits, sampling, shell_share(field, limits.gate_m))


def test_noise_lowers_what_can_be_asked_for() -> None:
    clean, noisy, drowned = reference(0.1, 0.0), reference(0.1, 0.1), reference(0.1, 0.6)
    assert 1.0 >= clean > noisy >= drowned >= LEAST
    assert clean > 0.7


def test_it_is_no_matter_of_chance() -> None:
    assert reference(0.15, 0.03) == reference(0.15, 0.03)
