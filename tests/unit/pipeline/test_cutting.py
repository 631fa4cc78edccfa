"""Models cut from a scene."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from spinpipe.pipeline.scenes.artificial import make_scene
from spinpipe.pipeline.scenes.cutting import cut_instance
from spinpipe.stages.geometry.frames import transform, yaw_matrix


@pytest.fixture(scope="module")
def scene():
    return make_scene(points=150_000)


@pytest.mark.parametrize("number", [0, 5])
def test_cut_car_is_the_car(scene, number):
    row = scene.truth[number]
    model = scene.models[row.model]
    size = np.ptp(model.vertices, axis=0) + 0.2
    rows, pose = cut_instance(scene.xyz, np.array([row.x, row.y]), size, row.heading_deg)
    of_car = scene.labels == row.label
    kept = scene.labels[rows]
    assert (kept == row.label).mean() > 0.99
    assert len(rows) > 0.85 * of_car.sum()  # the underside and the feet of the wheels are lost
    np.testing.assert_allclose(pose, yaw_matrix(row.heading_deg, [row.x, row.y, 0.0]), atol=0.02)
    cut = transform(np.linalg.inv(pose), scene.xyz[rows])
    assert KDTree(model.cloud).query(cut)[0].max() < 0.15


def test_stated_base_height_wins(scene):
    row = scene.truth[0]
    size = np.array([4.6, 2.0, 1.0])
    rows, pose = cut_instance(scene.xyz, np.array([row.x, row.y]), size, row.heading_deg, 0.6)
    assert pose[2, 3] == 0.6
    assert scene.xyz[rows, 2].min() > 0.6
    assert len(rows)


def test_bare_ground_gives_nothing(scene):
    ground = scene.xyz[scene.labels == 0]
    rows, _ = cut_instance(ground, np.array([2.0, 1.0]), np.array([4.0, 2.0, 1.5]), 30.0)
    assert len(rows) == 0
