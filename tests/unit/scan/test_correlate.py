"""The compiled kernels against the numpy twin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spinpipe.stages.scan.correlate import (
    ScanWork,
    build_index,
    correlate,
    histograms,
)
from spinpipe.stages.scan.image import SpinGrid, correlation, spin_image
from spinpipe.stages.scan.templates import Templates

GRIDS = [
    SpinGrid.of(2.5, 1.0, 0.1),
    SpinGrid.of(2.5, 1.0, 0.2),
    SpinGrid.of(1.0, 0.5, 0.25),
    SpinGrid.of(0.33, 0.71, 0.07),
]


def random_cloud(rng, n=600):
    return rng.random((n, 3)) * [8, 6, 2]


def gridded_cloud(rng, n=600, step=0.25):
    """Points exactly on bin borders, many of them twice."""
    return rng.integers(-12, 12, (n, 3)) * [step, step, step / 2]


def decimal_cloud(rng, n=600):
    return gridded_cloud(rng, n, 0.1)


def clumped_cloud(rng, n=600):
    """Many copies of few points, more than one run's buffer holds."""
    return np.repeat(random_cloud(rng, 5), 2000, axis=0)[rng.permutation(10_000)]


def line_cloud(rng, n=600):
    return np.outer(rng.random(n) * 5, [0.6, 0.8, -0.3])


def mast_cloud(rng, n=600):
    return np.outer(rng.random(n) * 5, [0, 0, 1])


def far_cloud(rng, n=600):
    """Coordinates so large that float32 leaves 6 cm steps."""
    return random_cloud(rng, n) + np.array([5e5, -7e5, 300])


def scattered_cloud(rng, n=600):
    """A dense middle and outliers at any distance."""
    cloud = random_cloud(rng, n)
    cloud[: n // 10] *= 10.0 ** rng.uniform(0, 30, (n // 10, 1))
    return cloud


def rim_cloud(rng, n=600):
    """Points exactly at the radius and the height of the grids around the origin, or beside."""
    zero_z = rng.choice(np.float32([0, 0.5, 1.0, 0.71, 0.25]), n)
    radius = rng.choice(np.float32([2.5, 1.0, 0.33]), n)
    towards = rng.choice(np.float32([0, 9]), (2, n))
    keep = rng.random((2, n)) < 0.5
    radius = np.where(keep[0], radius, np.nextafter(radius, towards[0]))
    zero_z = np.where(keep[1], zero_z, np.nextafter(zero_z, towards[1]))
    axis = rng.integers(0, 2, n)
    return np.stack([radius * axis, radius * (1 - axis), -zero_z], axis=1)


CLOUDS = [
    random_cloud,
    gridded_cloud,
    decimal_cloud,
    clumped_cloud,
    line_cloud,
    mast_cloud,
    far_cloud,
    scattered_cloud,
    rim_cloud,
]


def some_origins(cloud, rng, count=25):
    """Points of the cloud, points near it, the zero point, and one that sees nothing."""
    own = cloud[rng.integers(0, len(cloud), count)]
    return np.vstack([own, own[:5] + rng.normal(0, 0.3, (5, 3)), [[0, 0, 0], [0, 0, -1e4]]])


def templates_of(grid, rng):
    masked = rng.random(grid.shape) * (rng.random(grid.shape) < 0.7)
    return Templates.of(grid, rng.random((4, *grid.shape)), [None, None, masked, masked])


@pytest.mark.parametrize("make", CLOUDS)
@pytest.mark.parametrize("cell_m", [None, 0.13, 1.0, 50.0])
def test_histograms_equal_the_twin(make, cell_m):
    rng = np.random.default_rng(5)
    cloud = make(rng)
    index, origins = build_index(cloud, cell_m), some_origins(cloud, rng)
    for grid in GRIDS:
        expected = np.stack([spin_image(cloud, origin, grid) for origin in origins])
        np.testing.assert_array_equal(histograms(index, origins, grid), expected)
        assert expected.dtype == np.uint32


coordinate = st.one_of(
    st.floats(-4, 4, width=32),
    st.integers(-40, 40).map(lambda i: i / 10),
    st.integers(-16, 16).map(lambda i: i / 4),
    st.sampled_from([0.0, -0.0, 2.5, 1.0, 1e-30, 1e6, -1e6, 3e38, -3e38]),
)
points = st.lists(st.tuples(coordinate, coordinate, coordinate), max_size=40)


@settings(max_examples=200, deadline=None)
@given(points, points, st.sampled_from(GRIDS), st.sampled_from([0.1, 0.5, 3.0]))
def test_histograms_equal_the_twin_on_anything(cloud, extra, grid, cell_m):
    origins = np.array([*cloud, *extra, (0.0, 0.0, 0.0)], np.float32)
    points_m = np.array(cloud, np.float32).reshape(-1, 3)
    expected = np.stack([spin_image(points_m, origin, grid) for origin in origins])
    np.testing.assert_array_equal(
        histograms(build_index(points_m, cell_m), origins, grid), expected
    )


@pytest.mark.parametrize("make", CLOUDS)
@pytest.mark.parametrize("grid", GRIDS)
def test_correlations_equal_the_twin_for_any_threads_and_order(make, grid):
    rng = np.random.default_rng(6)
    cloud = make(rng)
    origins, templates = some_origins(cloud, rng, 60), templates_of(grid, rng)
    index = build_index(cloud)
    found = correlate(index, origins, templates, threads=1)
    assert found.shape == (templates.size, len(origins))
    assert found.dtype == np.float32
    images = [spin_image(cloud, origin, grid) for origin in origins]
    for row, values, weights in zip(found, templates.images, templates.weights, strict=True):
        expected = [correlation(image, values, weights) for image in images]
        np.testing.assert_allclose(row, expected, rtol=0, atol=2e-7)
    np.testing.assert_array_equal(correlate(index, origins, templates, threads=2), found)
    order, shuffle = rng.permutation(len(origins)), rng.permutation(len(cloud))
    again = correlate(build_index(cloud[shuffle], 0.3), origins[order], templates)
    np.testing.assert_array_equal(again, found[:, order])


def test_threads_share_many_chunks_and_tell_their_progress():
    rng = np.random.default_rng(7)
    cloud = rng.random((30_000, 3)) * [40, 40, 1]
    templates, index = templates_of(GRIDS[0], rng), build_index(cloud)
    steps, one, two = [], ScanWork(), ScanWork()
    alone = correlate(index, cloud, templates, 1, work=one)
    shared = correlate(index, cloud, templates, 2, advance=steps.append, work=two)
    np.testing.assert_array_equal(alone, shared)
    assert sum(steps) == len(cloud)
    assert len(steps) > 2
    assert one == two
    assert one.origins == len(cloud)
    assert one.visits > len(cloud)


def test_empty_single_and_no_templates():
    rng = np.random.default_rng(8)
    empty, single = build_index(np.zeros((0, 3))), build_index(np.array([[1.0, 2.0, 3.0]]))
    templates = templates_of(GRIDS[0], rng)
    assert histograms(empty, np.zeros((3, 3)), GRIDS[0]).sum() == 0
    assert not correlate(empty, np.zeros((3, 3)), templates).any()
    assert correlate(single, np.zeros((0, 3)), templates).shape == (4, 0)
    assert histograms(single, np.zeros((0, 3)), GRIDS[0]).shape == (0, 10, 25)
    assert correlate(single, np.zeros((4, 3)), Templates.of(GRIDS[0], [])).shape == (0, 4)
    assert histograms(single, np.array([[1.0, 2.0, 3.5]]), GRIDS[0])[0, 5, 0] == 1
    constant = Templates.of(GRIDS[0], [np.ones(GRIDS[0].shape)])
    assert correlate(single, np.array([[1.0, 2.0, 3.5]]), constant)[0, 0] == 0


def test_numbers_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="NaN"):
        build_index(np.array([[0.0, np.nan, 0.0]]))
    with pytest.raises(ValueError, match="NaN"):
        correlate(
            build_index(np.zeros((1, 3))), np.array([[np.inf, 0, 0]]), Templates.of(GRIDS[0], [])
        )
