"""Trimmed ICP: finds planted poses, knows the runner-up, counts what it kept."""

from __future__ import annotations

import numpy as np
import pytest

from spinpipe.pipeline.scenes.artificial_cars import SALOON, car_mesh
from spinpipe.stages.geometry.frames import heading_deg, transform, yaw_matrix
from spinpipe.stages.geometry.shapes import box, sample_surface
from spinpipe.stages.verify.icp.fit import IcpFit, start_poses
from spinpipe.stages.verify.icp.trimmed import trimmed_icp

L = np.array(
    [(0, 0.5 * i, i % 2) for i in range(5)] + [(0.5 * i, 0, (i + 1) % 2) for i in range(1, 4)],
    float,
)
"""An L of sparse points: once the pairs are right, the pose is exact."""
TOP = np.array([0.5, 0.5, 1.0])


def fit(
    samples: np.ndarray,
    cutout: np.ndarray,
    position: np.ndarray,
    top: np.ndarray = TOP,
    **changed: float,
) -> IcpFit:
    numbers = {"starts": 12, "iterations": 30, "keep": 0.8} | changed
    return trimmed_icp(
        samples,
        top,
        cutout.astype(np.float32),
        position,
        starts=int(numbers["starts"]),
        iterations=int(numbers["iterations"]),
        keep=numbers["keep"],
    )


@pytest.mark.parametrize("heading", [0.0, 47.0, 133.0, 222.0, 301.0])
def test_a_planted_pose_is_found(heading: float) -> None:
    T = yaw_matrix(heading, np.array([10.0, -4.0, 0.3]))
    found = fit(L, transform(T, L), transform(T, TOP[None])[0])
    np.testing.assert_allclose(found.poses[-1, found.best], T, atol=1e-3)
    assert found.rms_m[-1, found.best] < 1e-3


def test_a_car_is_found_although_the_candidate_is_off() -> None:
    rng = np.random.default_rng(0)
    mesh = car_mesh(SALOON)
    samples, cutout = (sample_surface(*mesh, n, rng)[0] for n in (500, 8000))
    T = yaw_matrix(75.0, np.array([3.0, 2.0, 0.0]))
    top = samples[np.argmax(samples[:, 2])]
    position = transform(T, top[None])[0] + [0.15, -0.1, -0.05]
    found = fit(samples, transform(T, cutout), position, top, iterations=60)
    pose = found.poses[-1, found.best]
    assert np.linalg.norm(pose[:3, 3] - T[:3, 3]) < 0.1
    assert abs(heading_deg(pose) - 75.0) < 5.0


def test_records_have_the_shapes_they_promise() -> None:
    found = fit(L, L, TOP, starts=7, iterations=4, keep=0.5)
    assert found.poses.shape == (5, 7, 4, 4)
    assert found.rms_m.shape == (5, 7)
    assert found.inliers.tolist() == [round(0.5 * len(L))] * 7
    np.testing.assert_allclose(found.start_heading_deg, np.arange(7) * 360 / 7)


def test_poses_stay_upright() -> None:
    rng = np.random.default_rng(1)
    found = fit(L, rng.normal(size=(50, 3)), np.zeros(3))
    poses = found.poses.reshape(-1, 4, 4)
    np.testing.assert_allclose(poses[:, 2, :3], np.tile([0, 0, 1.0], (len(poses), 1)), atol=1e-12)
    R = poses[:, :3, :3]
    np.testing.assert_allclose(
        R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-9
    )


def test_the_residual_never_grows() -> None:
    rng = np.random.default_rng(2)
    found = fit(L, rng.normal(size=(200, 3)), np.zeros(3))
    assert (np.diff(found.rms_m, axis=0) < 1e-5).all()


def test_the_runner_up_of_a_symmetric_thing_is_the_other_way_round() -> None:
    rng = np.random.default_rng(3)
    mesh = box(2.0, 0.6, 1.0)
    samples, cutout = (sample_surface(*mesh, n, rng)[0] for n in (400, 4000))
    found = fit(samples, cutout, np.array([0, 0, 1.0]), np.array([0, 0, 1.0]))
    assert found.runner_up is not None
    ends = [heading_deg(found.poses[-1, i]) for i in (found.best, found.runner_up)]
    assert abs((ends[0] - ends[1]) % 360 - 180) < 10
    rms = found.rms_m[-1]
    assert rms[found.runner_up] < 1.5 * rms[found.best]


def test_one_start_has_no_runner_up() -> None:
    assert fit(L, L, TOP, starts=1).runner_up is None


def test_trimming_leaves_a_missing_part_out() -> None:
    T = yaw_matrix(20.0, np.array([1.0, 1.0, 0.0]))
    seen = transform(T, L)[1:]
    found = fit(L, seen, transform(T, TOP[None])[0], iterations=60)
    np.testing.assert_allclose(found.poses[-1, found.best], T, atol=1e-3)


@pytest.mark.parametrize("cutout", [[[0.0, 0.0, 0.0]], [[1.0, 2.0, 3.0]] * 5], ids=["one", "equal"])
def test_degenerate_cutouts_give_finite_poses(cutout: list[list[float]]) -> None:
    found = fit(L, np.array(cutout), TOP)
    assert np.isfinite(found.poses).all()
    assert np.isfinite(found.rms_m).all()


def test_threads_do_not_change_a_bit() -> None:
    rng = np.random.default_rng(4)
    cutout = rng.normal(size=(500, 3)).astype(np.float32)
    one, two = (
        trimmed_icp(L, TOP, cutout, TOP, starts=12, iterations=15, keep=0.8, threads=threads)
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one.poses, two.poses)


def test_starts_put_the_top_on_the_candidate() -> None:
    position = np.array([4.0, 5.0, 6.0])
    poses = start_poses(position, TOP, 12)
    for T in poses:
        np.testing.assert_allclose(transform(T, TOP[None])[0], position, atol=1e-12)
    np.testing.assert_allclose([heading_deg(T) for T in poses], np.arange(12) * 30, atol=1e-9)
