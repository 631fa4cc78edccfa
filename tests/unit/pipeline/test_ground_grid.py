"""Local ground below whatever stands on it."""

import numpy as np
import pytest

from spinpipe.pipeline.scenes.ground_grid import ground_grid


def slope(rng, count=40_000):
    xy = rng.uniform(0, 20, (count, 2))
    return np.column_stack([xy, 0.1 * xy[:, 0] - 0.05 * xy[:, 1]])


def test_slope_with_a_box_on_it():
    rng = np.random.default_rng(0)
    ground = slope(rng)
    on_box = (np.abs(ground[:, :2] - [8.0, 12.0]) < [2.0, 1.0]).all(axis=1)
    points = ground.copy()
    points[on_box, 2] += 1.5
    grid = ground_grid(
        [points[:15_000], points[15_000:]],
        np.zeros(2),
        np.full(2, 20.0),
        cell_m=0.25,
        window_m=6.0,
        step_m=0.5,
    )
    # Off the box exact to the slope within a cell; below it the ground of the nearest cell
    error = grid.heights(ground[:, :2]) - ground[:, 2]
    assert np.abs(error[~on_box]).max() < 0.05
    assert np.abs(error[on_box]).max() < 0.2
    cells, _ = grid.cells(np.array([[8.0, 12.0], [3.0, 3.0]]))
    assert grid.seen[tuple(cells.T)].tolist() == [False, True]


def test_points_beyond_the_grid():
    grid = ground_grid(
        [np.array([[0.5, 0.5, 1.0], [90.0, 0.0, 5.0]])],
        np.zeros(2),
        np.full(2, 3.0),
        cell_m=1.0,
        window_m=2.0,
        step_m=0.5,
    )
    _, inside = grid.cells(np.array([[-0.1, 0.0], [2.9, 2.9]]))
    assert inside.tolist() == [False, True]
    assert grid.heights(np.array([[-50.0, 99.0]])).tolist() == [1.0]


def test_nothing_over_the_grid():
    with pytest.raises(ValueError, match="no point"):
        ground_grid([np.zeros((0, 3))], np.zeros(2), np.ones(2), cell_m=0.5, window_m=1, step_m=0.1)
