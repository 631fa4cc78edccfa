"""Meshes from code: closed, facing outwards, of the right size; samples spread by area."""

from __future__ import annotations

import math

import numpy as np
import pytest

from spinpipe.stages.geometry import shapes
from spinpipe.stages.geometry.frames import transform, yaw_matrix
from spinpipe.stages.geometry.shapes import Mesh

L_PROFILE = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]


def volume(mesh: Mesh) -> float:
    """Enclosed volume by the divergence theorem: positive only when faces look outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def directed_edges(mesh: Mesh) -> list[tuple[int, int]]:
    return [(int(f[i]), int(f[(i + 1) % 3])) for f in mesh.faces for i in range(3)]


@pytest.mark.parametrize(
    ("mesh", "expected", "tolerance"),
    [
        (shapes.box(2, 1, 3), 6, 1e-9),
        (shapes.cylinder(1, 2, 128), 2 * math.pi, 0.01),
        (shapes.cylinder(1, 2, 128, top_radius=0), 2 * math.pi / 3, 0.01),
        (shapes.ellipsoid((1, 2, 3), 96, 48), 8 * math.pi, 0.1),
        (shapes.extruded(L_PROFILE, 1), 3, 1e-9),
        (shapes.extruded(L_PROFILE[::-1], 1), 3, 1e-9),
    ],
    ids=["box", "cylinder", "cone", "ellipsoid", "concave profile", "profile turning right"],
)
def test_solids_are_closed_and_face_outwards(mesh: Mesh, expected: float, tolerance: float):
    assert volume(mesh) == pytest.approx(expected, abs=tolerance)
    assert mesh.vertices[:, 2].min() == 0


@pytest.mark.parametrize(
    "mesh", [shapes.box(2, 1, 3), shapes.cylinder(1, 2), shapes.extruded(L_PROFILE, 1)]
)
def test_every_edge_has_its_twin(mesh: Mesh):
    edges = directed_edges(mesh)
    assert len(set(edges)) == len(edges)
    assert {(b, a) for a, b in edges} == set(edges)


def test_samples_spread_by_area_and_lie_on_the_faces():
    box = shapes.box(2, 1, 3)
    points, normals = shapes.sample_surface(*box, 100_000, np.random.default_rng(0))
    np.testing.assert_allclose((normals**2).sum(axis=1), 1)
    top = normals[:, 2] > 0.5
    np.testing.assert_allclose(points[top, 2], 3)
    assert top.mean() == pytest.approx(2 / 22, abs=0.005)
    # Uniform within the face too: mean and variance of a uniform law on [-1, 1]
    assert points[top, 0].mean() == pytest.approx(0, abs=0.03)
    assert points[top, 0].var() == pytest.approx(1 / 3, abs=0.02)


def test_sampling_is_repeatable_and_takes_empty_requests():
    box = shapes.box(1, 1, 1)
    first = shapes.sample_surface(*box, 50, np.random.default_rng(3))
    second = shapes.sample_surface(*box, 50, np.random.default_rng(3))
    np.testing.assert_array_equal(first, second)
    points, normals = shapes.sample_surface(*box, 0, np.random.default_rng(3))
    assert points.shape == normals.shape == (0, 3)


def test_faces_without_area_are_never_drawn():
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (9, 9, 9.0)])
    faces = np.array([(3, 3, 3), (0, 1, 2), (0, 0, 3)])
    points, _ = shapes.sample_surface(vertices, faces, 1000, np.random.default_rng(0))
    np.testing.assert_array_equal(points[:, 2], 0)
    for empty in (faces[:1], faces[:0]):
        with pytest.raises(ValueError, match="no face with an area"):
            shapes.sample_surface(vertices, empty, 10, np.random.default_rng(0))


def test_poses_turn_counter_clockwise_then_move():
    ahead = np.array([(1.0, 0.0, 0.5)])
    for heading_deg, expected in [(0, (1, 0)), (90, (0, 1)), (180, (-1, 0)), (-90, (0, -1))]:
        T = yaw_matrix(heading_deg, (10, 20, 30))
        np.testing.assert_array_equal(
            shapes.transform(T, ahead), [(10 + expected[0], 20 + expected[1], 30.5)]
        )
    turned = transform(yaw_matrix(30), ahead)
    np.testing.assert_allclose(turned, [(math.cos(math.pi / 6), 0.5, 0.5)])


def test_only_points_below_a_face_are_covered():
    table = shapes.placed(shapes.box(2, 2, 0.1), (5, 0, 1))
    points = np.array([(5, 0, 0.5), (5, 0, 1.1), (5, 0, 2.0), (7, 0, 0.5), (5.9, -0.9, 0.0)])
    np.testing.assert_array_equal(
        shapes.covered_from_above(points, table), [True, False, False, False, True]
    )


@pytest.mark.parametrize(
    "corners", [[(0, 0), (1, 1), (1, 0), (0, 1)], [(0, 0), (0, 1), (1, 0)]], ids=["bow", "right"]
)
def test_polygons_without_an_ear_are_refused(corners: list[tuple[float, float]]):
    with pytest.raises(ValueError, match="crosses itself or turns right"):
        shapes.triangulated(np.array(corners, np.float64))
