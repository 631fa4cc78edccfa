"""The coarse search with bounds finds what an exhaustive one finds."""

import numpy as np
import pytest
from spinpipe.stages.verify.scene.surroundings import build_surroundings

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.shapes import Mesh, box, merged, placed, sample_surface
from spinpipe.stages.ingest.vehicles import vehicle_mesh
from spinpipe.stages.verify.fit import coarse_search
from spinpipe.stages.verify.judge.hypotheses import coarse_poses
from spinpipe.stages.verify.judge.tolerance import tolerance
from spinpipe.stages.verify.model.field import build_model_field
from spinpipe.stages.verify.model.lookup import field_arrays, half_diagonal
from spinpipe.stages.verify.scene.candidate_points import Points

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
    return build_surroundings(cloud, SAMPLING, 4.0)


def _exhaustive(scene, field, limits, place):
    """Gains of all poses by themselves, then the best ones that are distinct."""
    arrays, grid = field_arrays(field), scene.grid
    reach = half_diagonal.py_func(arrays) * (1 + limits.stretch)
    near = np.hypot(*(scene.points[:, :2] - place[:2]).T)
    near = near < reach + limits.offset_m + limits.coarse_gate_m
    ceiling = place[2] + field.size[2] * limits.stretch + 2 * limits.coarse_gate_m
    low = scene.heights <= limits.low_m
    body = np.flatnonzero(near & ~low & (scene.points[:, 2] < ceiling))
    ground = np.flatnonzero(near & low)
    points = []
    for rows in (body, ground):
        stride = max(1, -(-len(rows) // coarse_search.COARSE_POINTS))
        rows = rows[::stride]
        points.append(Points(scene.points[rows], scene.weights[rows] * stride))
    ground_z = scene.ground_at(place[None, :2])[0]
    poses = coarse_search.poses_to_try.py_func(arrays, limits, *place, ground_z)
    enough = 0.1 * field.size[0] * field.size[1] / grid.cell_m**2
    gains = np.array(
        [
            coarse_search.coarse_fit(*points, arrays, pose, limits.coarse_gate_m, enough)
            for pose in poses
        ]
    )
    kept = []
    for n in np.argsort(-gains, kind="stable"):
        others = poses[kept]
        if gains[n] > 0 and coarse_search.is_distinct.py_func(poses[n], others, limits):
            kept.append(n)
        if len(kept) == KEEP:
            break
    return poses[kept], gains[kept]


@pytest.mark.parametrize(("kind", "stretch"), [("saloon", 0.15), ("van", 0.0)])
def test_bounds_leave_out_only_what_is_not_among_the_best(scene, kind, stretch):
    points, normals = sample_surface(*vehicle_mesh(kind), 30_000, np.random.default_rng(0))
    field = build_model_field(kind, points, normals)
    limits = tolerance(field, stretch, SAMPLING.spacing_m, SAMPLING.noise_m)
    places = np.array(
        [[0.2, 0.1, 1.4], [2.3, 1.2, 1.9], [-4, 2, 1.2], [1.3, 0.5, 1.5], [5, 5, 1.2]]
    )
    poses, gains = coarse_poses(scene, field, limits, places, KEEP, 2)
    for k, place in enumerate(places):
        expected_poses, expected_gains = _exhaustive(scene, field, limits, place)
        found = gains[k] > 0
        assert found.sum() == len(expected_gains)
        assert np.array_equal(poses[k][found], expected_poses)
        assert np.array_equal(gains[k][found], expected_gains)


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
