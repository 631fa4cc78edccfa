"""A fit that may be a part of something larger, and what excuses it."""

from __future__ import annotations

import numpy as np

from spinpipe.stages.continuation import continuing_sides

SIZE = np.array([[2.0, 1.0, 0.8], [2.0, 1.0, 0.8]])
BESIDE = np.array([[3.0, 4.0, 0.0, np.pi / 2], [3.0 - 1.2, 4.0, 0.0, np.pi / 2]])
"""The second stands left of the first one: +y of the first is -x of the world."""


def sides(first: list[float], *, accepted: bool) -> list[str]:
    drops = np.array([first, [1.0, 1.0, 1.0, 1.0]])
    return continuing_sides(BESIDE, SIZE, drops, np.array([True, accepted]))


def test_a_side_without_a_drop_goes_on() -> None:
    assert sides([1.0, 1.0, 1.0, 0.1], accepted=True) == ["right", ""]
    assert sides([0.0, 1.0, 1.0, 1.0], accepted=True) == ["front", ""]


def test_an_instance_there_explains_it_and_a_rejected_fit_does_not() -> None:
    assert sides([1.0, 0.0, 1.0, 1.0], accepted=True) == ["", ""]
    assert sides([1.0, 0.0, 1.0, 1.0], accepted=False) == ["left", ""]


def test_a_drop_on_all_sides_is_an_end() -> None:
    assert sides([0.9, 0.5, 0.4, 0.3], accepted=False) == ["", ""]


def test_nothing_to_judge() -> None:
    empty = np.zeros((0, 4))
    assert continuing_sides(empty, np.zeros((0, 3)), empty, np.zeros(0, bool)) == []
