"""Transforms between the scene, the local frame and the world."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spinpipe.schemas.records import SceneFrame, Upright
from spinpipe.stages.geometry.frames import (
    heading_deg,
    local_from_scene,
    to_world,
    transform,
    world_from_scene,
    yaw_matrix,
)

HALF = float(np.sqrt(0.5))
FRAME = SceneFrame((500_000.0, 4_000_000.0, 100.0), (2.0, 2.0, 2.0), 10, 0, False, "scene.ply")
UPRIGHT = Upright((HALF, 0.0, 0.0, HALF), (0.0, 0.0, 3.0))
"""Turns +y to +z, then lifts by 3 m."""


def test_local_is_scene_less_origin_times_scale() -> None:
    scene = np.array([[500_001.0, 4_000_002.0, 103.0]])
    np.testing.assert_allclose(transform(local_from_scene(FRAME), scene), [[2, 4, 6]])


def test_world_is_local_turned_upright() -> None:
    scene = np.array([[500_001.0, 4_000_002.0, 103.0]])
    np.testing.assert_allclose(
        transform(world_from_scene(FRAME, UPRIGHT), scene), [[2, -6, 7]], atol=1e-9
    )
    local = np.array([[2, 4, 6]], np.float32)
    assert to_world(UPRIGHT, local).dtype == np.float32
    np.testing.assert_allclose(to_world(UPRIGHT, local), [[2, -6, 7]], atol=1e-6)


def test_a_whole_millimetre_survives_georeferenced_coordinates() -> None:
    T = world_from_scene(FRAME, UPRIGHT)
    scene = np.array([[500_010.001, 4_000_010.002, 110.003]])
    back = transform(np.linalg.inv(T), transform(T, scene))
    np.testing.assert_allclose(back, scene, atol=1e-6)


@given(heading=st.floats(0, 359.999), x=st.floats(-1e3, 1e3))
def test_a_heading_comes_back(heading: float, x: float) -> None:
    T = yaw_matrix(heading, np.array([x, 1.0, 2.0]))
    assert (heading_deg(T) - heading + 180) % 360 - 180 == pytest.approx(0, abs=1e-9)
    assert T[:3, 3].tolist() == [x, 1.0, 2.0]


@pytest.mark.parametrize(("heading", "ahead"), [(0, [1, 0]), (90, [0, 1]), (180, [-1, 0])])
def test_headings_go_counter_clockwise_from_x(heading: float, ahead: list[float]) -> None:
    T = yaw_matrix(heading, np.zeros(3))
    np.testing.assert_allclose(T[:2, 0], ahead, atol=1e-12)
    assert 0 <= heading_deg(T) < 360
