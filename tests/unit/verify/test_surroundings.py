import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.columns import column_order
from spinpipe.stages.geometry.frames import leaning
from spinpipe.stages.geometry.sampling import measure_sampling
from spinpipe.stages.verify.judge.hypotheses import Place
from spinpipe.stages.verify.scene.cell_grid import grid_of


def _plane(rng, density, noise, extent=20.0, slope=0.0):
    xy = rng.uniform(0, extent, (int(density * extent**2), 2))
    return np.c_[xy, slope * xy[:, 0] + rng.normal(0, noise, len(xy))]


@pytest.mark.parametrize(("density", "noise"), [(100, 0.02), (100, 0.2), (600, 0.005)])
def test_measures_density_and_noise(density, noise):
    rng = np.random.default_rng(1)
    ground = _plane(rng, density, noise, slope=0.05)
    wall = np.c_[rng.uniform(0, 20, 20_000), np.full(20_000, 10.0), rng.uniform(0, 5, 20_000)]
    strays = rng.uniform(-20, 40, (300, 3))
    found = measure_sampling(np.concatenate([ground, wall, strays]))
    assert found.spacing_m == pytest.approx(density**-0.5, rel=0.2)
    assert found.noise_m == pytest.approx(noise, rel=0.2)


def test_too_few_points():
    with pytest.raises(ValueError, match="too few"):
        measure_sampling(np.zeros((10, 3)))


def test_columns_ignore_the_order_of_points():
    rng = np.random.default_rng(2)
    points = rng.uniform(-5, 5, (3000, 3))
    shuffled = points[rng.permutation(len(points))]
    a, b = column_order(points, 0.5), column_order(shuffled, 0.5)
    assert np.array_equal(points[a[0]], shuffled[b[0]])
    for one, other in zip(a[1:], b[1:], strict=True):
        assert np.array_equal(one, other)


def test_cells_hold_their_points():
    rng = np.random.default_rng(3)
    ground = _plane(rng, 100, 0.01, slope=0.02)
    grid = grid_of(ground, Sampling(0.1, 0.01))
    cell = np.floor((grid.points[:, :2] - grid.corner) / grid.cell_m + 1e-9).astype(int)
    number = cell[:, 0] * grid.columns + cell[:, 1]
    counts = np.bincount(number, minlength=grid.rows * grid.columns)
    assert np.array_equal(np.diff(grid.start), counts)
    assert grid.weights.min() > 0
    assert grid.weights.max() <= 1


def test_a_tile_is_ordered_as_the_whole():
    rng = np.random.default_rng(4)
    points = _plane(rng, 100, 0.01)
    sampling = Sampling(0.1, 0.01)
    whole, part = grid_of(points, sampling), grid_of(points[points[:, 0] < 10], sampling)
    inner, same = whole.points[:, 0] < 7, part.points[:, 0] < 7
    assert np.array_equal(whole.points[inner], part.points[same])


@given(
    slopes=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    place=st.tuples(st.floats(-2, 22), st.floats(-2, 22), st.floats(-3, 3)),
    radius=st.floats(0.3, 8),
)
@settings(max_examples=30)
def test_a_place_is_seen_in_its_own_frame_as_plain_numpy_sees_it(slopes, place, radius):
    rng = np.random.default_rng(5)
    cloud = _plane(rng, 40, 0.3)
    grid = grid_of(cloud, Sampling(0.16, 0.3))
    seen = Place(np.array(place), np.array(slopes), 1.0).scene(grid, radius)
    near = np.hypot(*(grid.points[:, :2] - place[:2]).T) < radius
    turned = (grid.points[near] - place) @ leaning(slopes)
    half = seen.rows // 2 * seen.cell_m
    turned = turned[(np.abs(turned[:, :2]) < half - 1e-9).all(axis=1)]
    inner = seen.points[(np.abs(seen.points[:, :2]) < half - 1e-9).all(axis=1)]
    order = [np.lexsort(np.round(p, 9).T) for p in (turned, inner)]
    assert np.allclose(turned[order[0]], inner[order[1]], atol=1e-9)
