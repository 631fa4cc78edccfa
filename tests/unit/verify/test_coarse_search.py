"""Bounds of the coarse search: never lower than the gain, and what their plain twin says."""

import functools

import numpy as np
import pytest
from tests.unit.verify.twins import coarse_search as twin_coarse_search

from spinpipe.schemas.records import Sampling
from spinpipe.stages.compiled import kept
from spinpipe.stages.geometry.shapes import Mesh, box, merged, placed, sample_surface
from spinpipe.stages.ingest.vehicles import vehicle_mesh
from spinpipe.stages.verify.fit.coarse_bounds import gain_bounds
from spinpipe.stages.verify.judge import kernels
from spinpipe.stages.verify.judge.hypotheses import Place
from spinpipe.stages.verify.judge.tolerance import tolerance
from spinpipe.stages.verify.model.field import build_model_field
from spinpipe.stages.verify.scene.cell_grid import grid_of

SAMPLING = Sampling(0.1, 0.02)


@kept("verify")
def bounds_of(body, ground, field, limits, base, tall, enough, bounds):
    """``gain_bounds`` by itself, which is only called by other kernels."""
    gain_bounds(body, ground, field, limits, base, tall, enough, bounds)


@functools.cache
def field_of(kind):
    points, normals = sample_surface(*vehicle_mesh(kind), 30_000, np.random.default_rng(0))
    return build_model_field(kind, points, normals)


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
def test_no_pose_gains_more_than_its_bound(scene, kind, stretch):
    """And bounds are what their twin says; that none is left out wrongly is in ``test_twins``."""
    field = field_of(kind)
    limits = tolerance(field, stretch, SAMPLING, 0.03)._replace(headings=6)
    for x, y, top in np.array([[0.2, 0.1, 1.4], [2.3, 1.2, 1.9]]):
        place = Place(np.array([x, y, 0.0]), np.zeros(2), top)
        around = place.scene(scene, kernels.reach(field, limits) + 1.0)
        body, ground, enough = twin_coarse_search.coarse_points(around, field, limits, top)
        poses, gains = twin_coarse_search.coarse_gains(around, field, limits, top)
        bounds = np.empty(len(poses))
        base, tall = poses[0, 2], poses[0, 6]
        bounds_of(body, ground, field, limits, base, tall, enough, bounds)
        assert (bounds >= gains).all()
        assert (gains > 0.2 * bounds.max()).any()
        expected = twin_coarse_search.gain_bounds(body, ground, field, limits, base, tall, enough)
        np.testing.assert_allclose(bounds, expected, rtol=1e-4)


def test_no_point_of_a_voxel_is_nearer_than_its_clearance():
    field = field_of("saloon")
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
