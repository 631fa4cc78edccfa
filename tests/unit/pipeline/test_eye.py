"""Where a viewer first looks: everything is in view, and fills it."""

from __future__ import annotations

import numpy as np
import pytest

from spinpipe.pipeline.drawing.eye import SQUARE, TAN_UP, WIDE, Eye, is_long, scene_eye

CUBE = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T.astype(float)


def seen(eye: Eye, points: np.ndarray) -> np.ndarray:
    """(N, 2) places as shares of half the view's height."""
    forward = (eye.target - eye.position) / np.linalg.norm(eye.target - eye.position)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    x, y, depth = ((points - eye.position) @ a for a in (right, np.cross(right, forward), forward))
    assert (depth > 0).all()
    return np.column_stack([x, y]) / (TAN_UP * depth[:, None])


@pytest.mark.parametrize("size", [(60, 50, 3), (50, 60, 3), (80, 30, 2), (30, 80, 2)])
def test_the_ground_is_in_view_and_fills_it(size: tuple[float, float, float]) -> None:
    corners = CUBE * size + (300.0, -20.0, 4.0)
    places = seen(scene_eye(corners), corners[corners[:, 2] == 4.0])
    half_width = WIDE if is_long(corners) else SQUARE
    assert (abs(places) <= (half_width + 1e-6, 1 + 1e-6)).all()
    reach = np.ptp(places, axis=0) / (2 * half_width, 2)
    assert reach.max() > 0.9  # touches two sides of the view
    assert reach.min() > 0.45


def test_cameras_are_in_view() -> None:
    corners = CUBE * (60, 50, 3)
    cameras = np.array([[x, y, 46.0] for x in (-10, 30, 70) for y in (0, 50)])
    eye = scene_eye(np.concatenate([corners, cameras]))
    assert (abs(seen(eye, cameras)) <= (SQUARE + 1e-6, 1 + 1e-6)).all()
