"""A spin image is taken where every instance shows the same, not where one of them has a bump."""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.geometry.model_surface import topmost_point
from spinpipe.stages.geometry.shapes import box, cylinder, sample_surface
from spinpipe.stages.scan.image import SpinGrid, correlation, spin_image
from spinpipe.stages.scan.model_origin import typical_point
from spinpipe.stages.scan.templates import object_image

GRID = SpinGrid.of(2.1, 2.1, 0.26)
LIFT_M = 0.13


def roof(rng: np.random.Generator, bump_at: tuple[float, float] | None) -> F64:
    """A bus: a long box from above, perhaps with a bump of half a metre on its roof."""
    points = sample_surface(*box(18.0, 2.9, 3.0), 6000, rng)[0]
    points = points[(points[:, 2] > 0.3) & (rng.random(len(points)) < 0.3 + 0.7 * points[:, 2] / 3)]
    points = points + 0.02 * rng.standard_normal(points.shape)
    if bump_at:
        near = np.hypot(*(points[:, :2] - bump_at).T) < 0.5
        points[near & (points[:, 2] > 2.8), 2] += 0.5
    return points


def best_on(points: F64, image: F64, rng: np.random.Generator) -> float:
    """The greatest correlation of an instance's top points with an image."""
    top = points[points[:, 2] > 2.8]
    places = top[rng.choice(len(top), 100, replace=False)]
    return max(correlation(spin_image(points, p + [0, 0, LIFT_M], GRID), image) for p in places)


def test_a_bump_of_the_model_does_not_hide_instances_without_one():
    rng = np.random.default_rng(1)
    for bump in ((8.0, 1.0), (-3.0, -0.9), (0.0, 0.0)):
        model, instance = roof(rng, bump), roof(rng, None)
        typical = typical_point(model, GRID, LIFT_M)
        image = object_image(model, GRID, typical + [0, 0, LIFT_M])
        at_the_bump = object_image(model, GRID, topmost_point(model) + [0, 0, LIFT_M])
        assert abs(typical[2] - 3.0) < 0.15
        assert best_on(instance, image, rng) > 0.9
        assert best_on(instance, image, rng) > best_on(instance, at_the_bump, rng)


def test_it_is_near_the_middle_of_a_small_top():
    rng = np.random.default_rng(2)
    mesh = cylinder(1.0, 2.0)
    place = typical_point(sample_surface(*mesh, 4000, rng)[0], SpinGrid.of(1.5, 1.4, 0.2), 0.1)
    assert place[2] > 1.9
    assert np.hypot(*place[:2]) < 0.6


def test_an_antenna_is_no_top():
    rng = np.random.default_rng(3)
    body = sample_surface(*box(4.0, 1.8, 1.5), 4000, rng)[0]
    antenna = np.column_stack([rng.normal(0, 0.01, (40, 2)), rng.uniform(1.5, 2.3, 40)])
    place = typical_point(np.concatenate([body, antenna]), SpinGrid.of(1.3, 1.0, 0.16), 0.08)
    assert abs(place[2] - 1.5) < 0.05


def test_a_model_of_one_place_has_it():
    spike = np.array([[0.0, 0.0, z] for z in np.linspace(0, 1, 50)])
    assert typical_point(spike, SpinGrid.of(1.0, 0.7, 0.1), 0.05)[2] > 0.9
