"""How far chance lowers the correlation of an instance that few points show."""

from __future__ import annotations

import numpy as np
import pytest

from spinpipe.stages.geometry.model_surface import points_on
from spinpipe.stages.geometry.shapes import Mesh, box, sample_surface, surface_area
from spinpipe.stages.ingest.vehicles import vehicle_mesh
from spinpipe.stages.scan.hit_threshold import (
    MIN_CORRELATION,
    counting_loss,
    hit_threshold,
)

EXPECTED = np.array([[0.0, 3.0, 9.0, 1.0], [0.5, 0.0, 4.0, 2.0]])


@pytest.mark.parametrize("scale", [0.3, 1.0, 10.0])
def test_the_loss_is_what_poisson_counts_show(scale: float) -> None:
    rng = np.random.default_rng(0)
    counts = rng.poisson(scale * EXPECTED.ravel(), (4000, EXPECTED.size))
    # over many images, as one bin's chance is not another's
    shown = np.corrcoef(counts.ravel(), np.tile(EXPECTED.ravel(), 4000))[0, 1]
    assert counting_loss(scale * EXPECTED) == pytest.approx(shown, abs=0.01)


def test_many_points_lose_nothing_and_an_empty_image_is_no_division() -> None:
    assert counting_loss(1e6 * EXPECTED) == pytest.approx(1.0, abs=1e-5)
    assert counting_loss(np.zeros((2, 4))) == 1.0
    assert hit_threshold([]) == MIN_CORRELATION


def test_the_least_counted_model_decides() -> None:
    few, many = EXPECTED / 10, 100 * EXPECTED
    assert hit_threshold([many, few]) == hit_threshold([few]) < hit_threshold([many])


@pytest.mark.parametrize("mesh", [box(1.0, 0.5, 0.3), Mesh(*vehicle_mesh("saloon"))])
def test_points_on_a_surface(mesh: Mesh) -> None:
    points, _ = sample_surface(*mesh, 40_000, np.random.default_rng(1))
    assert points_on(points, 100.0) == pytest.approx(100.0 * surface_area(mesh), rel=0.35)


def test_a_point_has_no_surface() -> None:
    assert points_on(np.full((1, 3), 7.0), 100.0) == 0.0
