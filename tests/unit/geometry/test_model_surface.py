"""Dense surfaces of models with normals, from meshes and from clouds."""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.records import ObjectModel
from spinpipe.stages.geometry.model_surface import SURFACE_POINTS, model_surface
from spinpipe.stages.geometry.shapes import box, sample_surface

MESH = box(2.0, 1.0, 0.5)


def model(*, mesh: bool, normals: bool) -> ObjectModel:
    points, known = sample_surface(*MESH, 6000, np.random.default_rng(0))
    return ObjectModel(
        name="box",
        points=points.astype(np.float32),
        normals=(known if normals else np.zeros_like(known)).astype(np.float32),
        vertices=(MESH.vertices if mesh else np.empty((0, 3))).astype(np.float32),
        faces=(MESH.faces if mesh else np.empty((0, 3))).astype(np.int32),
        T_object_model=np.eye(4),
        visible_from="all",
    )


def test_a_mesh_is_sampled_densely() -> None:
    points, normals = model_surface(model(mesh=True, normals=True), np.random.default_rng(1))
    assert points.shape == normals.shape == (SURFACE_POINTS, 3)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)


def test_a_cloud_keeps_its_points_and_normals() -> None:
    given = model(mesh=False, normals=True)
    points, normals = model_surface(given, np.random.default_rng(1))
    np.testing.assert_array_equal(points, given.points)
    np.testing.assert_array_equal(normals, given.normals)


def test_away_from_edges_estimated_normals_are_those_of_the_faces_up_to_sign() -> None:
    points, estimated = model_surface(model(mesh=False, normals=False), np.random.default_rng(1))
    true = model(mesh=False, normals=True).normals
    depth = np.minimum(points - points.min(axis=0), points.max(axis=0) - points)
    inner = np.sort(depth, axis=1)[:, 1] > 0.1
    assert inner.sum() > 2000
    assert np.abs(np.sum(estimated * true, axis=1))[inner].min() > 0.99
