"""Compiled kernels say what their plain twins say, on ordinary scenes and on nasty ones.

Through the outermost kernels, which are what is cached and called: points cut out, every step of a
registration, all evidence at its end, and the coarse search.
"""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.unit.verify.twins import coarse_search as twin_coarse_search
from tests.unit.verify.twins import evidence as twin_evidence
from tests.unit.verify.twins import registration as twin_registration
from tests.unit.verify.twins import scene as twin_scene

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.shapes import box, cylinder, merged, placed, sample_surface
from spinpipe.stages.ingest.vehicles import vehicle_mesh
from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.judge import kernels
from spinpipe.stages.verify.judge.hypotheses import coarse_poses, course_of, refine_poses
from spinpipe.stages.verify.judge.tolerance import tolerance
from spinpipe.stages.verify.model.field import build_model_field
from spinpipe.stages.verify.scene.candidate_points import TOO_FEW
from spinpipe.stages.verify.scene.cell_grid import grid_of

MESHES = {
    "saloon": vehicle_mesh("saloon"),
    "crate": box(1.2, 0.8, 1.0),
    "barrel": cylinder(0.4, 1.1, 24),
    "table": merged([placed(box(1.6, 0.9, 0.1), (0, 0, 0.8)), box(0.3, 0.3, 0.8)]),
    "beam": box(4.0, 0.6, 0.7),
}


@functools.cache
def field_of(name):
    points, normals = sample_surface(*MESHES[name], 12_000, np.random.default_rng(0))
    return build_model_field(name, points, normals, resolution=32, spread=2500, probes=120)


@st.composite
def cases(draw):
    """A model, a scene around the origin in which it may stand, touch, be hidden; a start."""
    name = draw(st.sampled_from(sorted(MESHES)))
    field = field_of(name)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    spacing = draw(st.sampled_from([0.08, 0.15, 0.4]))
    noise = draw(st.sampled_from([0.0, 0.02, 0.1]))
    stretch = draw(st.sampled_from([0.0, 0.12]))
    length, width, height = field.size
    others = {
        "itself": MESHES[name],
        "neighbour": placed(MESHES[name], (0, 1.02 * width, 0)),
        "wall": placed(box(6.0, 0.3, 2 * height), (0, -width / 2 - 0.2, 0)),
        "roof": placed(box(3.0, 3.0, 0.1), (0.5, 0, 2.5 * height)),
        "plinth": placed(box(length, width, height), (0, 0, -height)),
        "block": box(1.3 * length, 1.1 * width, 0.8 * height),
    }
    items = [others[key] for key in draw(st.sets(st.sampled_from(sorted(others)), max_size=4))]
    half = length / 2 + 1.5
    ground = rng.uniform(-half, half, (int((2 * half / spacing) ** 2), 3)) * [1, 1, 0]
    if draw(st.booleans()):  # a hole below the body
        ground = ground[(np.abs(ground[:, :2]) > field.size[:2] / 2).any(axis=1)]
    parts = [ground[: draw(st.sampled_from([0, 3, len(ground)]))]]
    for mesh in items:
        points, _ = sample_surface(*mesh, draw(st.sampled_from([8, 300, 1500])), rng)
        parts.append(points)
    points = np.concatenate(parts) + 0.0
    points += rng.normal(0, noise, points.shape) + [*draw(st.sampled_from([(0, 0), (3, -7)])), 0]
    if draw(st.booleans()):  # on the borders of cells and voxels, many of them twice
        pitch = spacing / 2
        points = np.round(points / pitch) * pitch
    if len(points) == 0:
        points = np.zeros((1, 3))
    sampling = Sampling(spacing, noise)
    limits = tolerance(field, stretch, sampling, draw(st.sampled_from([0.0, 0.05])))
    start = np.ones(7)
    start[:3] = rng.normal(0, draw(st.sampled_from([0.0, 0.1, 1.0])), 3)
    start[3] = draw(st.sampled_from([0.0, np.pi / 2, -3.0, rng.uniform(-7, 7)]))
    if stretch:
        start[4:] += rng.uniform(-stretch, stretch, 3)
    return grid_of(points, sampling), field, limits, start


@settings(max_examples=60)
@given(case=cases())
def test_registration_and_evidence_are_what_their_twins_say(case):
    scene, field, limits, start = case
    poses, found = refine_poses(scene, field, limits, start[None])
    body, ground = twin_scene.fine_points(scene, field, limits, start)
    course = course_of(scene, field, limits, start)
    if len(body.xyz) < TOO_FEW:
        assert np.array_equal(poses[0], start)
        assert not found.any()
        assert len(course.poses) == 0
        return
    assert np.array_equal(course.poses[-1], poses[0])
    off, steps = twin_registration.follow(body, ground, field, limits, course.poses)
    assert off < 1e-7
    assert steps == len(course.poses) - 1
    everywhere = np.ones(4, bool)
    for pose, rms_m in zip(course.poses, course.rms_m, strict=True):
        _, explained, square_sum = twin_evidence.claim(body, field, pose, limits.gate_m, everywhere)
        assert rms_m == pytest.approx(np.sqrt(square_sum / explained) if explained else np.inf)
    expected = twin_evidence.evidence(scene, body, field, poses[0], limits)
    for name, value in zip(EVIDENCE, found[0], strict=True):
        assert value == pytest.approx(expected[name], rel=1e-9, abs=1e-9), name


@settings(max_examples=25)
@given(case=cases(), top=st.floats(0.3, 2.0))
def test_the_coarse_search_finds_what_trying_all_poses_finds(case, top):
    scene, field, limits, _ = case
    assert kernels.reach(field, limits) == pytest.approx(
        twin_coarse_search.search_reach(field, limits)
    )
    poses, gains = coarse_poses(scene, field, limits, top, 3)
    expected_poses, expected_gains = twin_coarse_search.coarse_poses(scene, field, limits, top, 3)
    assert (gains > 0).sum() == len(expected_gains)
    assert np.array_equal(gains[gains > 0], expected_gains)
    assert np.array_equal(poses[gains > 0], expected_poses)
