"""The coarse search with bounds finds what an exhaustive one finds."""

import math

import numpy as np
import pytest

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.shapes import Mesh, box, merged, placed, sample_surface
from spinpipe.stages.ingest.vehicles import vehicle_mesh
from spinpipe.stages.verify.fit import coarse_search
from spinpipe.stages.verify.judge import kernels
from spinpipe.stages.verify.judge.hypotheses import Place, coarse_poses
from spinpipe.stages.verify.judge.tolerance import tolerance
from spinpipe.stages.verify.model.field import build_model_field
from spinpipe.stages.verify.model.lookup import field_arrays
from spinpipe.stages.verify.scene.candidate_points import Points
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


def _exhaustive(scene, field, limits, top):
    """Gains of all poses by themselves, then the best ones that are distinct."""
    arrays = field_arrays(field)
    near = np.hypot(*scene.points[:, :2].T) < kernels.reach(arrays, limits)
    ceiling = top + field.size[2] * limits.stretch + 2 * limits.coarse_gate_m
    height = scene.points[:, 2]
    body = np.flatnonzero(near & (height > limits.low_m) & (height < ceiling))
    ground = np.flatnonzero(near & (np.abs(height) <= limits.low_m))
    points = []
    for rows in (body, ground):
        stride = max(1, -(-len(rows) // coarse_search.COARSE_POINTS))
        rows = rows[::stride]
        points.append(Points(scene.points[rows], scene.weights[rows] * stride))
    poses = _poses(arrays, limits, top)
    enough = 0.1 * field.size[0] * field.size[1] / scene.cell_m**2
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


def _poses(arrays, limits, top):
    """Every heading at whole steps around the origin, see ``coarse_search.poses_to_try``."""
    tall = np.clip(top / arrays.size[2], 1 - limits.stretch, 1 + limits.stretch)
    base = top - tall * arrays.size[2] if limits.stretch > 0 else 0.0
    tall = tall if limits.stretch > 0 else 1.0
    narrow = arrays.size[:2].min() / 2
    reach = np.where(arrays.top_half > 1.5 * narrow, arrays.top_half, limits.offset_m)
    half = np.ceil(reach / limits.step_m).astype(int)
    along, across = (np.arange(-n, n + 1) * limits.step_m for n in half)
    poses = []
    for h in range(limits.headings):
        yaw = 2 * math.pi * h / limits.headings
        cos, sin = math.cos(yaw), math.sin(yaw)
        for dx in along:
            for dy in across:
                ox, oy = dx - arrays.top[0], dy - arrays.top[1]
                x, y = cos * ox - sin * oy, sin * ox + cos * oy
                poses.append([x, y, base, yaw, 1.0, 1.0, tall])
    return np.array(poses)


@pytest.mark.parametrize(("kind", "stretch"), [("saloon", 0.15), ("van", 0.0)])
def test_bounds_leave_out_only_what_is_not_among_the_best(scene, kind, stretch):
    points, normals = sample_surface(*vehicle_mesh(kind), 30_000, np.random.default_rng(0))
    field = build_model_field(kind, points, normals)
    limits = tolerance(field, stretch, SAMPLING, 0.03)
    places = np.array(
        [[0.2, 0.1, 1.4], [2.3, 1.2, 1.9], [-4, 2, 1.2], [1.3, 0.5, 1.5], [5, 5, 1.2]]
    )
    arrays = field_arrays(field)
    for x, y, top in places:
        place = Place(np.array([x, y, 0.0]), np.zeros(2), top)
        around = place.scene(scene, kernels.reach(arrays, limits) + 1.0)
        poses, gains = coarse_poses(around, arrays, limits, top, KEEP)
        expected_poses, expected_gains = _exhaustive(around, field, limits, top)
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
