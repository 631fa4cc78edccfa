"""KISS-ICP as another registration: same promises as trimmed ICP."""

from __future__ import annotations

import numpy as np
import pytest

from spinpipe.pipeline.scenes.artificial_cars import SALOON, car_mesh
from spinpipe.stages.geometry.frames import heading_deg, transform, yaw_matrix
from spinpipe.stages.geometry.shapes import sample_surface
from spinpipe.stages.verify.icp.fit import IcpFit
from spinpipe.stages.verify.icp.kiss import kiss_icp_fit

RNG = np.random.default_rng(0)
SAMPLES = sample_surface(*car_mesh(SALOON), 500, RNG)[0]
CAR = sample_surface(*car_mesh(SALOON), 2000, RNG)[0]
TOP = SAMPLES[np.argmax(SAMPLES[:, 2])]


def fit(cutout: np.ndarray, position: np.ndarray, threads: int = 1) -> IcpFit:
    return kiss_icp_fit(
        SAMPLES,
        TOP,
        cutout.astype(np.float32),
        position,
        starts=12,
        iterations=15,
        keep=0.8,
        threads=threads,
    )


@pytest.mark.parametrize("heading", [10.0, 130.0, 250.0])
def test_a_planted_car_is_found(heading: float) -> None:
    T = yaw_matrix(heading, np.array([3.0, 2.0, 0.1]))
    found = fit(transform(T, CAR), transform(T, TOP[None])[0] + [0.1, 0.05, 0.0])
    pose = found.poses[-1, found.best]
    assert np.linalg.norm(pose[:3, 3] - T[:3, 3]) < 0.05
    assert abs((heading_deg(pose) - heading + 180) % 360 - 180) < 2.0


def test_records_have_the_shapes_they_promise() -> None:
    found = fit(CAR, TOP)
    assert found.poses.shape == (2, 12, 4, 4)
    assert found.rms_m.shape == (2, 12)
    assert found.inliers.tolist() == [400] * 12
    np.testing.assert_allclose(found.start_heading_deg, np.arange(12) * 30, atol=1e-9)


def test_poses_are_upright_and_finite_also_without_any_pair() -> None:
    far = CAR + [500.0, 0.0, 0.0]
    for cutout in (CAR, far, far[:1]):
        found = fit(cutout, TOP)
        assert np.isfinite(found.poses).all()
        np.testing.assert_allclose(found.poses[-1, :, 2, :3], np.tile([0, 0, 1.0], (12, 1)))


def test_the_same_input_gives_the_same_bits() -> None:
    first = fit(CAR, TOP + [0.2, 0.0, 0.0])
    for threads in (1, 2):
        again = fit(CAR, TOP + [0.2, 0.0, 0.0], threads)
        np.testing.assert_array_equal(first.poses, again.poses)
