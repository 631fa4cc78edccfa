"""What stands beyond the sides of a fit, and when it is a part of something larger."""

from __future__ import annotations

import numpy as np
import pytest

from spinpipe.stages.verify.decide.continuation import (
    explained_sides,
    first_continuing,
    fits_farther_on,
)
from spinpipe.stages.verify.evidence.outline import SIDES

SIZE = np.array([[2.0, 1.0, 0.8]])
FIT = np.array([[3.0, 4.0, 0.0, np.pi / 2]])
ON_ITS_LEFT = np.array([[3.0 - 1.2, 4.0, 0.0, np.pi / 2]])
"""+y of the fit is -x of the world."""


def test_an_instance_beside_a_fit_explains_that_side() -> None:
    explained = explained_sides(FIT, SIZE, ON_ITS_LEFT, SIZE)
    assert explained.tolist() == [[False, True, False, False]]


@pytest.mark.parametrize("side", range(4))
def test_it_explains_no_other_side(side: int) -> None:
    away = np.array([[2.1, 0.0], [0.0, 1.2], [-2.1, 0.0], [0.0, -1.2]])[side]
    level = np.array([[0.0, 0.0, 0.0, 0.0]])
    explained = explained_sides(level, SIZE, level + [*away, 0.0, 0.0], SIZE)
    assert np.flatnonzero(explained).tolist() == [side]


@pytest.mark.parametrize(("ahead_m", "explains"), [(0.9, True), (1.3, False)])
def test_it_explains_a_side_that_it_covers_by_half(ahead_m: float, explains: bool) -> None:
    level = np.array([[0.0, 0.0, 0.0, 0.0]])
    explained = explained_sides(level, SIZE, level + [ahead_m, 1.2, 0.0, 0.0], SIZE)
    assert explained[0, SIDES.index("left")] == explains


def test_a_fit_does_not_explain_itself_nor_one_that_is_far() -> None:
    assert not explained_sides(FIT, SIZE, FIT + [0.1, 0.1, 0, 0], SIZE).any()
    assert not explained_sides(FIT, SIZE, ON_ITS_LEFT - [3.0, 0, 0, 0], SIZE).any()


def test_it_is_the_same_for_many_fits_at_once() -> None:
    poses = np.tile(FIT, (300, 1)) + np.arange(300)[:, None] * [10.0, 0, 0, 0]
    near = poses + (ON_ITS_LEFT - FIT)
    sizes = np.tile(SIZE, (300, 1))
    assert explained_sides(poses, sizes, near, sizes)[:, 1].all()


def test_the_model_fits_farther_on_where_it_is_a_part() -> None:
    onward = FIT - [0.0, 0.5, 0.0, 0.0]  # half of its length back, -y of the world
    assert fits_farther_on(FIT[0], SIZE[0], onward).tolist() == [False, False, True, False]
    corner = FIT + [-0.3, -0.5, 0.0, np.pi]  # a corner of a larger body, however turned
    assert fits_farther_on(FIT[0], SIZE[0], corner).tolist() == [False, True, True, False]


def test_neither_itself_nor_a_neighbour_is_farther_on() -> None:
    for other in (FIT + [0.05, 0.05, 0.0, 0.1], FIT - [0.0, 1.6, 0.0, 0.0], np.empty((0, 4))):
        assert not fits_farther_on(FIT[0], SIZE[0], other).any()


def test_a_level_surface_goes_on_where_the_model_fits_and_no_instance_explains_it() -> None:
    levels = np.array([[0.1, 0.9, 0.0, 0.0]])
    none, all_sides = np.zeros((1, 4), bool), np.ones((1, 4), bool)
    assert first_continuing(levels, none, all_sides) == ["left"]
    assert first_continuing(levels, np.array([[False, True, False, False]]), all_sides) == [""]
    assert first_continuing(levels, none, none) == [""]
    assert first_continuing(np.full((1, 4), 0.2), none, all_sides) == [""]


def test_nothing_to_judge() -> None:
    empty = np.zeros((0, 4))
    none = explained_sides(empty, np.zeros((0, 3)), FIT, SIZE)
    assert none.shape == (0, 4)
    assert first_continuing(empty, none, none) == []
    assert not explained_sides(FIT, SIZE, empty, np.zeros((0, 3))).any()
