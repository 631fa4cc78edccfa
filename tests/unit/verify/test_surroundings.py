import numpy as np
import pytest
from spinpipe.stages.verify.scene.surroundings import build_surroundings

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.columns import column_order
from spinpipe.stages.geometry.sampling import measure_sampling


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


def test_cells_hold_their_points_and_heights_start_at_the_ground():
    rng = np.random.default_rng(3)
    ground = _plane(rng, 100, 0.01, slope=0.02)
    box = np.c_[rng.uniform(8, 12, (1600, 2)), rng.uniform(1.2, 1.3, 1600)]
    scene = build_surroundings(np.concatenate([ground, box]), Sampling(0.1, 0.01), 4.0)
    cell = np.floor((scene.points[:, :2] - scene.corner) / scene.cell_m + 1e-9).astype(int)
    number = cell[:, 0] * scene.cells[1] + cell[:, 1]
    assert np.array_equal(
        scene.start[1:] - scene.start[:-1], np.bincount(number, minlength=int(scene.cells.prod()))
    )
    on_box = scene.points[:, 2] > 1.1
    assert np.abs(scene.heights[~on_box]).max() < 0.25
    assert scene.heights[on_box].min() > 0.9
    assert abs(scene.ground_at(np.array([[10.0, 10.0]]))[0] - 0.2) < 0.15
    assert scene.weights.min() > 0
    assert scene.weights.max() <= 1


def test_a_tile_is_ordered_as_the_whole():
    rng = np.random.default_rng(4)
    points = _plane(rng, 100, 0.01)
    sampling = Sampling(0.1, 0.01)
    whole = build_surroundings(points, sampling, 1.0)
    part = build_surroundings(points[points[:, 0] < 10], sampling, 1.0)
    inner = whole.points[:, 0] < 7
    same = part.points[:, 0] < 7
    assert np.array_equal(whole.points[inner], part.points[same])
    assert np.allclose(whole.heights[inner], part.heights[same])
