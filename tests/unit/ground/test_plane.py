"""Planes of neighbourhoods: what they know of noise and normals."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from spinpipe.stages.ground.plane import is_collinear, local_planes, reliable_local_planes


def patch(rng, n, rotation, height, noise=0.0, size=10.0):
    flat = np.c_[rng.uniform(-size, size, (n, 2)), height + rng.normal(0, noise, n)]
    return rotation.apply(flat)


def test_local_planes_measure_noise_and_normals():
    rng = np.random.default_rng(4)
    local = local_planes(patch(rng, 20_000, Rotation.identity(), 0.0, 0.02))
    assert np.median(local.deviations) == pytest.approx(0.02, rel=0.2)
    assert np.median(np.abs(local.normals[:, 2])) > 0.98


def test_collinear_points_span_no_plane():
    line = np.outer(np.arange(10.0), [1, 2, 3]) + 5
    assert is_collinear(line)
    assert not is_collinear(np.concatenate([line, [[0, 0, 9]]]))


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
