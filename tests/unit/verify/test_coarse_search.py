"""The coarse search with bounds finds what an exhaustive one finds."""

import numpy as np
import pytest
from tests.unit.verify import twins

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.shapes import Mesh, box, merged, placed, sample_surface
from spinpipe.stages.ingest.vehicles import vehicle_mesh
from spinpipe.stages.verify.judge import kernels
from spinpipe.stages.verify.judge.hypotheses import Place, coarse_poses
from spinpipe.stages.verify.judge.tolerance import tolerance
from spinpipe.stages.verify.model.field import build_model_field
from spinpipe.stages.verify.scene.cell_grid import grid_of

SAMPLING = Sampling(0.1, 0.02)
KEEP = 3


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(5)
    saloon, van = (Mesh(*vehicle_mesh(kind)) for kind in ("saloon", "van"))
    items = [
        placed(saloon, (0, 0, 0), 20),
        placed(van, (2.6, 1.0, 0), 25),
        placed(box(3.0, 1.0, 1.2), (-4, 2, 0), 70),
    ]
    points, _ = sample_surface(*merged(items), 9000, rng)
    ground = np.c_[rng.uniform(-10, 10, (40_000, 2)), np.zeros(40_000)]
    cloud = np.concatenate([points, ground]) + rng.normal(0, 0.02, (49_000, 3))
    return grid_of(cloud, SAMPLING)


@pytest.mark.parametrize(("kind", "stretch"), [("saloon", 0.15), ("van", 0.0)])
def test_bounds_leave_out_only_what_is_not_among_the_best(scene, kind, stretch):
    points, normals = sample_surface(*vehicle_mesh(kind), 30_000, np.random.default_rng(0))
    field = build_model_field(kind, points, normals)
    limits = tolerance(field, stretch, SAMPLING, 0.03)
    places = np.array([[0.2, 0.1, 1.4], [2.3, 1.2, 1.9], [5, 5, 1.2]])
    for x, y, top in places:
        place = Place(np.array([x, y, 0.0]), np.zeros(2), top)
        around = place.scene(scene, kernels.reach(field, limits) + 1.0)
        poses, gains = coarse_poses(around, field, limits, top, KEEP)
        expected_poses, expected_gains = twins.coarse_poses(around, field, limits, top, KEEP)
        found = gains > 0
        assert found.sum() == len(expected_gains)
        assert np.array_equal(poses[found], expected_poses)
        assert np.array_equal(gains[found], expected_gains)


def test_no_point_of_a_voxel_is_nearer_than_its_clearance():
    points, normals = sample_surface(*vehicle_mesh("saloon"), 30_000, np.random.default_rng(0))
    field = build_model_field("saloon", points, normals)
    rng = np.random.default_rng(1)
    voxel = rng.integers(0, field.clearance.shape, (1000, 3))
    inside = field.origin + (voxel + rng.random(voxel.shape)) * field.voxel_m
    distance = np.linalg.norm(inside[:, None] - field.samples[None], axis=-1).min(axis=1)
    clearance = field.clearance[tuple(voxel.T)]
    assert (distance**2 >= np.abs(clearance)).all()
    half = field.size[:2] / 2
    boxed = (np.abs(inside[:, :2]) < half).all(axis=1) & (inside[:, 2] > 0)
    boxed &= inside[:, 2] < field.size[2]
    assert boxed[clearance < 0].all()
    assert (clearance < 0).sum() > 50
