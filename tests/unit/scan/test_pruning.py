"""The pruned scan finds the hits of the exhaustive scan, all and only those."""

from __future__ import annotations

import numpy as np
import pytest

from spinpipe.stages.scan.correlate import BELOW, ScanWork, build_index, correlate
from spinpipe.stages.scan.image import SpinGrid, spin_image
from spinpipe.stages.scan.templates import Templates

GRIDS = [
    SpinGrid.of(2.5, 1.0, 0.1),
    SpinGrid.of(2.5, 1.0, 0.2),
    SpinGrid.of(1.3, 0.95, 0.1),  # height and radius that are no multiple of the bin
    SpinGrid.of(1.04, 0.5, 0.25),
]


def rough_ground(rng, n=6_000):
    return rng.random((n, 3)) * [6, 5, 0] + rng.normal(0, 0.03, (n, 1)) * [0, 0, 1]


def boxes_on_ground(rng, n=6_000):
    cloud = rough_ground(rng, n)
    for x, y in rng.random((4, 2)) * [5, 4]:
        inside = (abs(cloud[:, 0] - x) < 0.8) & (abs(cloud[:, 1] - y) < 0.4)
        cloud[inside, 2] += 1.2
    return cloud


def wall(rng, n=6_000):
    return rng.random((n, 3)) * [4, 0.02, 5]


def foliage(rng, n=6_000):
    return rng.normal(0, 0.8, (n, 3))


def layers(rng, n=6_000):
    """Exactly level sheets and points exactly above each other."""
    return rng.integers(0, 40, (n, 3)) * [0.1, 0.1, 0.125]


def far_boxes(rng, n=6_000):
    return boxes_on_ground(rng, n) + np.array([3e5, -4e5, 50])


CLOUDS = [rough_ground, boxes_on_ground, wall, foliage, layers, far_boxes]


def likely_templates(cloud, grid, rng):
    """Templates that some origins resemble: their own images, disturbed; every other masked."""
    images, weights = [], []
    for origin in cloud[rng.integers(0, len(cloud), 2)]:
        image = spin_image(cloud, origin, grid) * rng.uniform(0.7, 1.3, grid.shape)
        images += [image, image + 1]
        weights += [None, rng.random(grid.shape) * (rng.random(grid.shape) < 0.6)]
    return Templates.of(grid, images, weights), [
        Templates.of(grid, [image], [weight]) for image, weight in zip(images, weights, strict=True)
    ]


@pytest.mark.parametrize("make", CLOUDS)
def test_hits_equal_the_exhaustive_scan(make):
    rng = np.random.default_rng(0)
    cloud = make(rng)
    index = build_index(cloud)
    for grid in GRIDS:
        templates, single = likely_templates(cloud, grid, rng)
        every = correlate(index, cloud, templates, 2)
        for least in (0.2, 0.6, 0.9):
            hits = correlate(index, cloud, templates, 2, min_correlation=least)
            expected = np.where(every >= np.float32(least), every, BELOW)
            np.testing.assert_array_equal(hits, expected)
        # One template at a time prunes more than all together.
        for row, template in enumerate(single):
            hits = correlate(index, cloud, template, min_correlation=0.6)[0]
            np.testing.assert_array_equal(hits, np.where(every[row] >= 0.6, every[row], BELOW))


@pytest.mark.parametrize("make", CLOUDS)
def test_hits_near_the_least_correlation_are_kept(make):
    """The least correlation is one that origins have, or just beside it."""
    rng = np.random.default_rng(3)
    cloud = make(rng)
    index, template = build_index(cloud), likely_templates(cloud, GRIDS[0], rng)[1][0]
    every = correlate(index, cloud, template)[0]
    ranked = np.sort(every[every > 0.05])
    for level in ranked[:: max(1, len(ranked) // 7)]:
        for least in (level, np.nextafter(level, np.float32(2)), np.nextafter(level, BELOW)):
            hits = correlate(index, cloud, template, min_correlation=float(least))[0]
            np.testing.assert_array_equal(hits, np.where(every >= least, every, BELOW))


def test_dense_ground_is_pruned():
    rng = np.random.default_rng(4)
    cloud = rough_ground(rng, 40_000)
    grid = GRIDS[0]
    roof = np.zeros(grid.shape)
    roof[0, :8], roof[5, 4:20] = np.arange(8), 3.0
    every, pruned = ScanWork(), ScanWork()
    index, template = build_index(cloud), Templates.of(grid, [roof])
    correlate(index, cloud, template, work=every)
    hits = correlate(index, cloud, template, min_correlation=0.6, work=pruned)
    assert (hits == BELOW).all()
    assert pruned.visits * 4 < every.visits  # the patch is mostly border
    assert pruned.scanned * 4 < every.scanned == len(cloud)
    assert pruned.tests > 0


@pytest.mark.parametrize("least", [0.0, -0.5, float("nan")])
def test_least_correlation_must_be_positive(least):
    index = build_index(np.zeros((1, 3)))
    with pytest.raises(ValueError, match="positive"):
        correlate(index, np.zeros((1, 3)), Templates.of(GRIDS[0], []), min_correlation=least)


def test_empty_inputs():
    rng = np.random.default_rng(5)
    template = Templates.of(GRIDS[0], [rng.random(GRIDS[0].shape)])
    empty = build_index(np.zeros((0, 3)))
    assert (correlate(empty, np.zeros((50, 3)), template, min_correlation=0.5) == BELOW).all()
    one = build_index(np.zeros((1, 3)))
    assert correlate(one, np.zeros((0, 3)), template, min_correlation=0.5).shape == (1, 0)
