"""Free places for planted objects."""

import itertools

import numpy as np
import pytest

from spinpipe.pipeline.scenes.free_places import Footprint, blocked_cells, free_places
from spinpipe.pipeline.scenes.ground_grid import GroundGrid


def flat(cells=100, cell_m=0.25):
    shape = (cells, cells)
    return GroundGrid(np.zeros(2), cell_m, np.zeros(shape), np.ones(shape, bool))


CAR = Footprint(4.0, 2.0, 1.5)


def corners(place, margin=0.0):
    half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [
        place.footprint.length_m / 2 + margin,
        place.footprint.width_m / 2 + margin,
    ]
    cos, sin = np.cos(np.radians(place.heading_deg)), np.sin(np.radians(place.heading_deg))
    return half @ np.array([[cos, sin], [-sin, cos]]) + [place.x, place.y]


def apart(a, b):
    """Separating axis theorem for two convex polygons."""
    for polygon in (a, b):
        for i in range(4):
            edge = polygon[i] - polygon[i - 1]
            normal = np.array([-edge[1], edge[0]])
            if (a @ normal).max() < (b @ normal).min() or (b @ normal).max() < (a @ normal).min():
                return True
    return False


def test_places_do_not_overlap_and_keep_clear():
    grid = flat()
    blocked = np.zeros(grid.height.shape, bool)
    blocked[40:60, 40:60] = True  # 5 m square in the middle
    places = free_places(grid, blocked, [CAR] * 12, 0.5, np.random.default_rng(0))
    assert len(places) == 12
    square = np.array([[10.0, 10.0], [15.0, 10.0], [15.0, 15.0], [10.0, 15.0]])
    for place in places:
        assert apart(corners(place, 0.45), square)
    for a, b in itertools.combinations(places, 2):
        assert apart(corners(a), corners(b))


def test_fewer_places_than_wished_when_there_is_no_room(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("spinpipe.pipeline.scenes.free_places.TRIES", 200)
    grid = flat(cells=40)  # 10 m square
    free = np.zeros(grid.height.shape, bool)
    places = free_places(grid, free, [CAR] * 20, 0.5, np.random.default_rng(0))
    assert 2 <= len(places) < 15
    assert free_places(grid, ~free, [CAR], 0.5, np.random.default_rng(0)) == []


def test_same_seed_same_places():
    grid = flat()
    free = np.zeros(grid.height.shape, bool)
    first = free_places(grid, free, [CAR] * 5, 0.5, np.random.default_rng(7))
    assert first == free_places(grid, free, [CAR] * 5, 0.5, np.random.default_rng(7))
    assert first != free_places(grid, free, [CAR] * 5, 0.5, np.random.default_rng(8))


@pytest.mark.parametrize(
    ("heights", "blocks"),
    [([0.05, 0.08], False), ([0.5, 0.9], True), ([0.5], False), ([2.0, 2.5], False)],
)
def test_what_blocks(heights, blocks):
    grid = flat(cells=4)
    points = np.array([[0.3, 0.3, h] for h in heights])
    assert blocked_cells(grid, [points], 0.1, 1.5)[1, 1] == blocks
