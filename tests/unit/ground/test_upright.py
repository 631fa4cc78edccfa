"""The quaternion that turns up to +z, and what cameras say about up."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from spinpipe.schemas.records import Upright
from spinpipe.stages.ground.evidence import camera_evidence, camera_up
from spinpipe.stages.ground.plane import FittedPlane
from spinpipe.stages.ground.upright import up_quaternion

GROUND = FittedPlane(np.array([0.0, 0.0, 1.0]), 0.0, 0.1)
component = st.floats(-1, 1, allow_subnormal=False)


@given(up=st.tuples(component, component, component).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_turns_up_to_z_by_the_smallest_angle(up):
    up = np.array(up) / np.linalg.norm(up)
    rotation = Rotation.from_quat(up_quaternion(up))
    np.testing.assert_allclose(rotation.apply(up), [0, 0, 1], atol=1e-7)
    assert rotation.magnitude() == pytest.approx(np.arctan2(np.hypot(*up[:2]), up[2]), abs=1e-6)


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-9, 1e-6])
def test_straight_down_is_half_a_turn(tilt):
    up = np.array([0.0, tilt, -1.0])
    quaternion = np.array(up_quaternion(up))
    assert np.linalg.norm(quaternion) == pytest.approx(1)
    np.testing.assert_allclose(Rotation.from_quat(quaternion).apply(up), [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(np.abs(quaternion), [1, 0, 0, 0], atol=1e-6)


def test_the_record_applies_the_same_rotation():
    up = np.array([0.3, -0.5, 0.2])
    quaternion = up_quaternion(up)
    T = Upright(quaternion, (0.0, 0.0, 2.5)).T_world_local
    np.testing.assert_allclose(T[:3, :3], Rotation.from_quat(quaternion).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(T @ [0, 0, 0, 1], [0, 0, 2.5, 1])


def looking(pitch_deg, headings_deg):
    """Camera-to-world rotations of upright cameras that look down by ``pitch_deg``."""
    level = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # z forward to +y, y down to -z
    pitch = Rotation.from_euler("x", -pitch_deg, degrees=True)
    turns = Rotation.from_euler("z", np.reshape(headings_deg, (-1, 1)), degrees=True)
    return (turns * pitch * Rotation.from_matrix(level)).as_matrix()


@pytest.mark.parametrize("pitch_deg", [0, 30, 60, 90])
def test_upright_cameras_above_the_ground_agree(pitch_deg):
    headings = np.arange(0, 360, 18.0)
    positions = np.c_[np.cos(headings), np.sin(headings), np.full(20, 5.0)]
    for plane, sign in ((GROUND, 1), (GROUND.flipped(), -1)):
        evidence = camera_evidence(positions, looking(pitch_deg, headings), plane)
        assert sign * evidence["cameras above"] > 0.9
        assert sign * evidence["cameras upright"] > 0.9


def test_cameras_on_both_sides_say_nothing():
    positions = np.array([[0, 0, 5.0], [0, 0, -5.0]])
    assert camera_evidence(positions, looking(0, [0, 0]), GROUND)["cameras above"] == 0


def test_level_cameras_that_turn_know_up():
    rng = np.random.default_rng(0)
    turn = Rotation.random(random_state=1)
    cameras = looking(20, rng.uniform(0, 90, 12)) @ Rotation.from_rotvec([0, 0, 0.02]).as_matrix()
    up = camera_up(turn.as_matrix() @ cameras)
    assert up is not None
    assert up @ turn.apply([0, 0, 1]) > np.cos(np.radians(3))
    wall = FittedPlane(turn.apply([1.0, 0, 0]), 0.0, 0.1)
    floor = FittedPlane(turn.apply([0, 0, 1.0]), 0.0, 0.1)
    positions = turn.apply(rng.uniform(1, 2, (12, 3)))
    assert camera_evidence(positions, turn.as_matrix() @ cameras, wall)["cameras level"] == -1
    assert camera_evidence(positions, turn.as_matrix() @ cameras, floor)["cameras level"] > 0.8


def test_cameras_that_do_not_turn_or_are_rolled_know_no_up():
    assert camera_up(looking(90, np.full(9, 30.0))) is None
    assert camera_up(Rotation.random(20, random_state=2).as_matrix()) is None
