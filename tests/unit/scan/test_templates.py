"""Neighbours inside the radius: what the masked correlation makes of them."""

from __future__ import annotations

import numpy as np

from spinpipe.stages.geometry.shapes import box, placed, sample_surface
from spinpipe.stages.scan.correlate import build_index, correlate
from spinpipe.stages.scan.image import SpinGrid
from spinpipe.stages.scan.templates import Templates, extent_weights, object_image

GRID = SpinGrid.of(2.0, 0.8, 0.1)


def crate(x: float, length: float, count: int, seed: int) -> np.ndarray:
    mesh = placed(box(length, 1.0, 0.9), (x, 0, 0))
    return sample_surface(*mesh, count, np.random.default_rng(seed))[0]


def best(cloud: np.ndarray, outside: float) -> float:
    image = object_image(crate(0, 1.0, 20_000, 0), GRID)
    masked = Templates.of(GRID, [image], [extent_weights(image, outside)])
    top = cloud[(cloud[:, 2] > 0.899) & (np.hypot(cloud[:, 0], cloud[:, 1]) < 0.1)]
    return float(correlate(build_index(cloud), top, masked).max())


def test_the_extent_is_that_of_each_depth() -> None:
    values = np.array([[3, 1, 0, 0, 0], [0, 0, 2, 0, 0], [0, 0, 0, 0, 0], [1, 0, 0, 0, 4]])
    expected = [[1, 1, 1, 0.2, 0.2], [1, 1, 1, 1, 0.2], [0.2] * 5, [1] * 5]
    np.testing.assert_array_equal(extent_weights(values, 0.2), expected)


def test_a_neighbour_disturbs_the_masked_correlation_less() -> None:
    alone = crate(0, 1.0, 20_000, 1)
    beside = np.concatenate([alone, crate(1.8, 2.0, 80_000, 2)])
    loss = {weight: best(alone, weight) - best(beside, weight) for weight in (1.0, 0.3, 0.0)}
    assert best(alone, 1.0) > 0.9
    assert loss[1.0] > 0.05
    assert loss[0.0] < loss[0.3] < loss[1.0]
    assert loss[0.0] < loss[1.0] / 1.5
