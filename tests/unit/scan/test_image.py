"""The numpy definition of spin images and their correlation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spinpipe.stages.geometry.model_surface import topmost_point
from spinpipe.stages.scan.image import SpinGrid, correlation, spin_image
from spinpipe.stages.scan.templates import Templates, object_image

CAR = SpinGrid.of(2.5, 1.0, 0.1)
BINARY = SpinGrid.of(1.0, 0.5, 0.25)
"""A grid whose borders are exact in binary."""


@pytest.mark.parametrize(
    ("radius_m", "height_m", "bin_m", "shape"),
    [
        (2.5, 1.0, 0.1, (10, 25)),
        (2.5, 1.0, 0.2, (5, 13)),
        (0.3, 0.3, 0.1, (3, 3)),
        (0.7, 2.1, 0.7, (3, 1)),
        (3.3, 1.1, 0.11, (10, 30)),
        (1.25, 0.95, 0.1, (10, 13)),
        (0.01, 0.01, 0.1, (1, 1)),
    ],
)
def test_rows_and_columns_round_up_but_not_over_whole_quotients(radius_m, height_m, bin_m, shape):
    grid = SpinGrid.of(radius_m, height_m, bin_m)
    assert grid.shape == shape
    assert grid.k == shape[0] * shape[1]


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_grid_refuses_impossible_sizes(bad):
    for sizes in [(bad, 1.0, 0.1), (2.5, bad, 0.1), (2.5, 1.0, bad)]:
        with pytest.raises(ValueError, match="positive number"):
            SpinGrid.of(*sizes)
    with pytest.raises(ValueError, match="larger bins"):
        SpinGrid.of(100.0, 100.0, 0.1)


sizes = st.floats(0.0625, 50, width=32)


@given(sizes, sizes, st.floats(0.005, 5))
def test_every_point_inside_has_a_bin(radius_m, height_m, bin_m):
    try:
        grid = SpinGrid.of(radius_m, height_m, bin_m)
    except ValueError:
        return
    zero = np.float32(0)
    radius, height = np.float32(radius_m), np.float32(height_m)
    a, b = np.nextafter(radius, zero), np.nextafter(height, zero)
    last = np.array([[a, 0, -b], [0, -a, -b], [0.6 * a, 0.8 * a, -b]], np.float32)
    counts = spin_image(last, np.zeros(3), grid)
    assert counts[:2].sum() + counts[2:].sum() >= 2
    beyond = np.array([[radius, 0, -b], [0, 0, -height], [0, 0, 0], [0, 0, 1]], np.float32)
    assert spin_image(beyond, np.zeros(3), grid).sum() == 0


def test_points_on_exact_borders_fall_into_the_farther_bin():
    points = [[0, 0, -0.25], [0.25, 0, -0.1], [0, -0.75, -0.499], [0.3, 0.4, -0.1]]
    counts = spin_image(np.array(points), np.zeros(3), BINARY)
    expected = np.zeros((2, 4), int)
    expected[1, 0] = expected[0, 1] = expected[1, 3] = expected[0, 2] = 1
    np.testing.assert_array_equal(counts, expected)


def test_far_and_overflowing_distances_are_outside():
    points = np.array([[3e38, 0, -0.5], [1e20, 1e20, -0.1], [-3e38, 0, -0.1]])
    assert spin_image(points, np.array([3e38, 0, 0]), CAR).sum() == 1


def test_empty_cloud():
    assert spin_image(np.zeros((0, 3)), np.zeros(3), CAR).sum() == 0


def test_correlation_is_pearson():
    rng = np.random.default_rng(0)
    a, b = rng.integers(0, 9, (2, 10, 25))
    assert correlation(a, b) == pytest.approx(np.corrcoef(a.ravel(), b.ravel())[0, 1], abs=1e-12)


def test_weights_repeat_and_mask_bins():
    rng = np.random.default_rng(1)
    a, b = rng.integers(0, 9, (2, 60)).astype(float)
    weights = rng.integers(0, 3, 60)
    repeated = np.corrcoef(np.repeat(a, weights), np.repeat(b, weights))[0, 1]
    assert correlation(a, b, weights) == pytest.approx(repeated, abs=1e-12)
    changed = a + 1000.0 * (weights == 0)
    assert correlation(changed, b, weights) == correlation(a, b, weights)


@pytest.mark.parametrize("level", [0.0, 1.0, 7.0, 1 / 3])
def test_constant_images_correlate_with_nothing(level):
    flat, other = np.full((3, 4), level), np.arange(12.0).reshape(3, 4)
    weights = np.linspace(0.1, 1, 12).reshape(3, 4)
    for w in (None, weights):
        assert correlation(flat, other, w) == 0.0
        assert correlation(other, flat, w) == 0.0
        assert correlation(flat, flat, w) == 0.0
    assert correlation(other, other, np.zeros((3, 4))) == 0.0
    grid = SpinGrid.of(0.4, 0.3, 0.1)
    assert not Templates.of(grid, [flat, flat], [None, weights]).values.any()


@given(st.integers(0, 2**32 - 1))
def test_correlation_ignores_gain_and_offset(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.random((2, 50))
    w = rng.random(50)
    r = correlation(a, b, w)
    assert -1 <= r <= 1
    assert correlation(3 * a + 5, b, w) == pytest.approx(r, abs=1e-9)
    assert correlation(b, a, w) == pytest.approx(r, abs=1e-9)


def test_unit_values_have_mean_zero_and_variance_one():
    rng = np.random.default_rng(2)
    grid = SpinGrid.of(0.4, 0.3, 0.1)
    templates = Templates.of(grid, rng.random((2, 3, 4)), [None, rng.random((3, 4))])
    for w, weighted in zip(templates.weights, templates.values, strict=True):
        assert w.sum() == pytest.approx(1)
        assert weighted.sum() == pytest.approx(0, abs=1e-12)
        assert (weighted**2 / w).sum() == pytest.approx(1)
    assert templates.even.tolist() == [True, False]
    assert templates.alike.tolist() == [False, False]


def test_template_refuses_bad_arrays():
    grid = SpinGrid.of(0.4, 0.3, 0.1)
    good = np.ones((3, 4))
    with pytest.raises(ValueError, match="shape"):
        Templates.of(grid, [np.ones((4, 3))])
    with pytest.raises(ValueError, match="NaN"):
        Templates.of(grid, [np.full((3, 4), np.nan)])
    with pytest.raises(ValueError, match="weights"):
        Templates.of(grid, [good], [np.zeros((3, 4))])
    with pytest.raises(ValueError, match="weights"):
        Templates.of(grid, [good], [-good])


def test_template_keeps_its_own_copy():
    grid, values = SpinGrid.of(0.4, 0.3, 0.1), np.ones((3, 4))
    template = Templates.of(grid, [values])
    values[:] = 0
    assert template.images.all()


def test_template_of_a_cloud_starts_at_its_topmost_point():
    rng = np.random.default_rng(3)
    cloud = rng.random((500, 3))
    top = cloud[np.argmax(cloud[:, 2])]
    np.testing.assert_array_equal(topmost_point(cloud, tolerance_m=0.0), top)
    image = object_image(cloud, CAR)
    expected = spin_image(cloud - topmost_point(cloud), np.zeros(3), CAR)
    np.testing.assert_array_equal(image, expected)
    moved = object_image(cloud + np.array([1e7, -1e7, 1e4]), CAR)
    assert np.abs(moved - image).sum() <= 4  # rounding of the moved cloud only


def test_flat_top_is_taken_in_its_middle():
    x, y = np.meshgrid(np.arange(5.0), np.arange(3.0))
    plate = np.stack([x.ravel(), y.ravel(), np.full(15, 2.0)], axis=1)
    np.testing.assert_array_equal(topmost_point(np.vstack([plate, [[9, 9, 0]]])), [2, 1, 2])
    with pytest.raises(ValueError, match="empty"):
        topmost_point(np.zeros((0, 3)))
