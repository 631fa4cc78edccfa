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


def test_a_crowned_yard_is_ground_and_the_row_on_it_is_not():
    rng = np.random.default_rng(3)
    ground = np.c_[rng.uniform(-40, 40, (200_000, 2)), np.zeros(200_000)]
    row = np.abs(ground[:, :2]) < (9, 12)  # buses side by side, rounded towards their ends
    on_row = row.all(axis=1)
    ground[:, 2] = -0.05 * np.abs(ground[:, 1])
    roof_m = 3.6 - 0.4 * np.maximum(np.abs(ground[:, 0]) - 7, 0)
    ground[on_row, 2] += roof_m[on_row]
    grid = ground_grid(
        [ground], np.full(2, -40), np.full(2, 40), cell_m=0.7, window_m=74, step_m=0.4
    )
    cells, _ = grid.cells(ground[:, :2])
    seen = grid.seen[cells[:, 0], cells[:, 1]]
    away = (np.abs(ground[:, :2]) > (10, 13)).any(axis=1)
    inner = (np.abs(ground[:, :2]) < (8, 11)).all(axis=1)
    assert seen[away].mean() > 0.95
    assert not seen[inner].any()
