"""What shows of a mesh: faces inside do not, whichever way they are wound."""

from __future__ import annotations

import numpy as np

from spinpipe.stages.geometry.seen_from_above import sample_seen, seen_from_around
from spinpipe.stages.geometry.shapes import box, merged, placed


def test_faces_inside_are_left_out() -> None:
    mesh = merged([box(2, 1, 1), placed(box(1, 0.5, 0.5), (0, 0, 0.25))])
    points, normals = sample_seen(mesh, 4000, seen_from_around, np.random.default_rng(0))
    inner = (np.abs(points - [0, 0, 0.5]) < [0.51, 0.26, 0.26]).all(axis=1)
    assert len(points) == len(normals) == 4000
    assert not inner.any()


def test_all_sides_of_a_box_show() -> None:
    points, normals = sample_seen(box(2, 1, 1), 4000, seen_from_around, np.random.default_rng(1))
    for axis, sign in [(0, 1), (0, -1), (1, 1), (1, -1), (2, 1)]:
        assert (normals[:, axis] * sign > 0.9).mean() > 0.05
    assert np.ptp(points, axis=0) @ np.ones(3) > 3.9
