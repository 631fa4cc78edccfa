"""RANSAC planes: exact on clean data, robust to clutter, one after the other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from spinpipe.stages.ground.plane import (
    FittedPlane,
    is_collinear,
    local_planes,
    ransac_plane,
    ransac_planes,
    refine_plane,
    reliable_local_planes,
)


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(abs(a @ b), -1, 1)))


def patch(rng, n, rotation, height, noise=0.0, size=10.0):
    flat = np.c_[rng.uniform(-size, size, (n, 2)), height + rng.normal(0, noise, n)]
    return rotation.apply(flat)


@given(seed=st.integers(0, 10_000), noise=st.sampled_from([0.0, 0.01, 0.05]))
@settings(max_examples=20, deadline=None)
def test_finds_a_plane_in_clutter(seed, noise):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed)
    clutter = rng.uniform(-10, 10, (2000, 3))
    points = np.concatenate([patch(rng, 2000, rotation, 1.5, noise), clutter])
    plane = ransac_plane(rng.permutation(points), max(3 * noise, 0.01), rng, min_share=0.3)
    normal = rotation.apply([0, 0, 1])
    assert angle_deg(plane.normal, normal) < 0.2
    assert abs(plane.offset) == pytest.approx(1.5, abs=0.02)
    assert np.linalg.norm(plane.normal) == pytest.approx(1)


def test_the_same_generator_gives_the_same_plane():
    points = np.random.default_rng(0).normal(size=(500, 3)) * (5, 5, 0.1)
    first, second = (
        ransac_plane(points, 0.1, np.random.default_rng(7), min_share=0.5) for _ in range(2)
    )
    assert np.array_equal(first.normal, second.normal)
    assert first.offset == second.offset


def test_planes_come_largest_first_and_not_twice():
    rng = np.random.default_rng(1)
    ground = patch(rng, 6000, Rotation.identity(), 0.0, 0.03)
    wall = patch(rng, 3000, Rotation.from_euler("y", 90, degrees=True), 2.0, 0.03)
    points = rng.permutation(np.concatenate([ground, wall]))
    planes = ransac_planes(points, local_planes(points).normals, 0.09, rng, count=5, min_share=0.05)
    assert len(planes) == 2
    assert angle_deg(planes[0].normal, np.array([0, 0, 1.0])) < 0.2
    assert angle_deg(planes[1].normal, np.array([1.0, 0, 0])) < 0.2


def test_a_volume_has_no_plane():
    rng = np.random.default_rng(2)
    points = rng.uniform(-1, 1, (5000, 3))
    assert (
        ransac_planes(points, local_planes(points).normals, 0.1, rng, count=3, min_share=0.1) == []
    )


def test_refining_widens_to_the_noise_that_is_there():
    rng = np.random.default_rng(3)
    points = patch(rng, 5000, Rotation.identity(), 0.0, 0.1)
    start = FittedPlane(np.array([0.01, 0, 1.0]) / np.hypot(0.01, 1), 0.0, 0.2)
    plane = refine_plane(points, start)
    assert plane.inlier_distance == pytest.approx(0.3, rel=0.1)
    assert angle_deg(plane.normal, np.array([0, 0, 1.0])) < 0.05
    assert refine_plane(points, start, fixed_distance=True).inlier_distance == 0.2


def test_local_planes_measure_noise_and_normals():
    rng = np.random.default_rng(4)
    local = local_planes(patch(rng, 20_000, Rotation.identity(), 0.0, 0.02))
    assert np.median(local.deviations) == pytest.approx(0.02, rel=0.2)
    assert np.median(np.abs(local.normals[:, 2])) > 0.98


def test_collinear_points_span_no_plane():
    line = np.outer(np.arange(10.0), [1, 2, 3]) + 5
    assert is_collinear(line)
    assert not is_collinear(np.concatenate([line, [[0, 0, 9]]]))
    with pytest.raises(ValueError, match="no three points"):
        ransac_plane(np.ones((5, 3)), 0.1, np.random.default_rng(0), min_share=0.5)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3, 0.6])
def test_normals_stay_known_where_noise_exceeds_the_spacing(noise):
    """Points 0.1 apart: 16 neighbours of one reach no farther than 0.2."""
    rng = np.random.default_rng(5)
    rotation = Rotation.random(random_state=5)
    points = patch(rng, 40_000, rotation, 0.0, noise)
    local = reliable_local_planes(points)
    along = np.abs(local.normals @ rotation.apply([0, 0, 1]))
    assert np.mean(along > np.cos(np.radians(20))) > 0.85
    assert np.quantile(local.deviations, 0.1) == pytest.approx(noise, rel=0.25)


def test_a_plane_holds_only_what_lies_along_it():
    """A level through the legs of many tables holds legs, not a surface."""
    rng = np.random.default_rng(6)
    ground = patch(rng, 12_000, Rotation.identity(), 0.0, 0.02)
    foot = rng.uniform(-9, 9, (60, 2))[rng.integers(60, size=8000)]
    legs = np.c_[foot + rng.uniform(-0.02, 0.02, foot.shape), rng.uniform(0.2, 1.4, 8000)]
    points = rng.permutation(np.concatenate([ground, legs]))
    local = reliable_local_planes(points)
    planes = ransac_planes(points, local.normals, 0.3, rng, count=4, min_share=0.1)
    assert len(planes) == 1
    assert angle_deg(planes[0].normal, np.array([0, 0, 1.0])) < 0.5


def test_clutter_does_not_widen_a_plane_step_by_step():
    rng = np.random.default_rng(7)
    flat = patch(rng, 3000, Rotation.identity(), 0.0, 0.03)
    clutter = rng.uniform((-10, -10, -1), (10, 10, 1), (12_000, 3))
    points = rng.permutation(np.concatenate([flat, clutter]))
    plane = ransac_plane(points, 0.1, rng, min_share=0.1)
    assert plane.inlier_distance <= 0.2 * (1 + 1e-9)
