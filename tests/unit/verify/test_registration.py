import numpy as np
import pytest
from tests.unit.verify.twins import coarse_search as twin_coarse_search
from tests.unit.verify.twins import registration as twin_registration

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.shapes import box, cylinder, merged, placed, sample_surface
from spinpipe.stages.ingest.vehicles import vehicle_mesh
from spinpipe.stages.verify.fit.registration import STEPS, Base
from spinpipe.stages.verify.judge.hypotheses import course_of
from spinpipe.stages.verify.judge.tolerance import tolerance
from spinpipe.stages.verify.model.field import build_model_field
from spinpipe.stages.verify.scene.candidate_points import Points
from spinpipe.stages.verify.scene.cell_grid import grid_of

SAMPLING = Sampling(0.1, 0.0)


@pytest.fixture(scope="module")
def saloon():
    points, normals = sample_surface(*vehicle_mesh("saloon"), 60_000, np.random.default_rng(0))
    return build_model_field("saloon", points, normals)


def _posed(points, pose):
    c, s = np.cos(pose[3]), np.sin(pose[3])
    return (points * pose[4:7]) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + pose[:3]


def _scene(kind, pose, count=2000, noise=0.0, seed=1):
    rng = np.random.default_rng(seed)
    points, _ = sample_surface(*vehicle_mesh(kind), count, rng)
    return _posed(points, pose) + rng.normal(0, noise, points.shape)


def _course(field, points, start, stretch=0.0, gate=0.1):
    """Poses of a registration from its start to its end."""
    limits = tolerance(field, stretch, SAMPLING, 0.0)._replace(gate_m=gate, coarse_gate_m=0.4)
    return course_of(grid_of(points, SAMPLING), field, limits, start).poses


@pytest.mark.parametrize("yaw", [0.0, 1.0, 2.5, -2.0])
def test_rigid_pose_is_recovered(saloon, yaw):
    truth = np.array([3.0, -2.0, 0.1, yaw, 1, 1, 1])
    start = truth + [0.2, -0.15, 0.1, 0.12, 0, 0, 0]
    course = _course(saloon, _scene("saloon", truth), start)
    pose = course[-1]
    assert np.abs(pose - course[-2]).max() < 1e-3
    assert np.abs(pose[:3] - truth[:3]).max() < 0.01
    assert abs(pose[3] - truth[3]) < np.radians(0.3)


def test_rigid_pose_under_noise(saloon):
    truth = np.array([0.0, 0.0, 0.0, 0.4, 1, 1, 1])
    points = _scene("saloon", truth, noise=0.05)
    pose = _course(saloon, points, truth + [0.2, 0.1, 0, -0.1, 0, 0, 0], gate=0.2)[-1]
    assert np.abs(pose[:3] - truth[:3]).max() < 0.03
    assert abs(pose[3] - truth[3]) < np.radians(1)


def test_stretch_is_recovered_within_its_bounds(saloon):
    truth = np.array([1.0, 1.0, 0.0, 0.3, 1.08, 0.95, 1.05])
    start = truth + [0.1, -0.1, 0, 0.05, 0, 0, 0]
    start[4:] = 1.0
    pose = _course(saloon, _scene("saloon", truth), start, stretch=0.15)[-1]
    assert np.abs(pose[4:] - truth[4:]).max() < 0.03
    pose = _course(saloon, _scene("saloon", truth), start, stretch=0.02)[-1]
    assert (np.abs(pose[4:] - 1) <= 0.02 + 1e-12).all()


def test_nothing_near_moves_nothing(saloon):
    start = np.array([0.0, 0, 0, 0, 1, 1, 1])
    far = [2.95, 0, 1.35] + np.random.default_rng(0).normal(0, 0.05, (50, 3))
    assert np.array_equal(_course(saloon, far, start), [start])


def test_a_hole_in_the_ground_guides_a_sparse_body(saloon):
    """A dark car: hardly a return from itself, but none from the ground below it either."""
    rng = np.random.default_rng(3)
    truth = np.array([0.0, 0.0, 0.0, 0.2, 1, 1, 1])
    ground = np.c_[rng.uniform(-5, 5, (12_000, 2)), np.zeros(12_000)]
    local = _posed(ground, [0, 0, 0, -0.2, 1, 1, 1])
    ground = ground[(np.abs(local[:, 0]) > 2.265) | (np.abs(local[:, 1]) > 0.9)]
    roof = _posed(
        np.c_[rng.uniform(-0.3, 0.0, 30), rng.uniform(-0.2, 0.2, 30), np.full(30, 1.42)], truth
    )
    start = truth + [0.25, 0.2, 0, 0.08, 0, 0, 0]
    nothing = np.empty((0, 3))
    off, off_alone = (
        np.hypot(*(_by_the_twin(saloon, roof, seen, start)[:2] - truth[:2]))
        for seen in (ground, nothing)
    )
    assert off < 0.15
    assert off < off_alone


def _by_the_twin(field, body, ground, pose):
    """The end of a registration; the kernel makes the same steps, see ``test_twins``."""
    body, ground = (Points(points, np.ones(len(points))) for points in (body, ground))
    for gate in (0.4, 0.2):
        hides = twin_registration.hides_ground(ground, field, pose, gate + 0.1)
        for _ in range(STEPS):
            made = twin_registration.step(
                body, ground, field, pose, gate, 0.1, hides, 0.0, Base(0.0, 0.0)
            )
            assert made is not None
            pose, moved = made
            if moved < 1e-3 * gate:
                break
    return pose


def test_coarse_fit_prefers_the_truth_and_bounds_hold(saloon):
    truth = np.array([0.0, 0.0, 0.0, 0.0, 1, 1, 1])
    points = _scene("saloon", truth)
    body, nothing = Points(points, np.ones(len(points))), Points(np.empty((0, 3)), np.empty(0))

    def fit(pose):  # the kernel gives the same, see test_twins
        return twin_coarse_search.coarse_fit(body, nothing, saloon, pose, 0.25, 50.0)

    best = fit(truth)
    assert 0.8 < best <= 1
    for wrong in ([0.8, 0, 0, 0], [0, 0.6, 0, 0], [0, 0, 0, np.pi / 2], [0, 0, 0, np.pi]):
        assert fit(truth + [*wrong, 0, 0, 0]) < best
    assert fit(truth + [30, 0, 0, 0, 0, 0, 0]) == 0


def test_field_knows_body_sight_and_symmetry(saloon):
    places = np.array([(0.0, 0.0), (0.9, 0.5), (0.0, 1.2), (2.6, 0.0)])
    column = np.floor((places - saloon.origin[:2]) / saloon.voxel_m).astype(int)
    assert saloon.footprint[tuple(column.T)].tolist() == [True, True, False, False]
    assert saloon.seen_weight.sum() == pytest.approx(1)
    assert (saloon.probe_normals[:, 2] > 0).all()
    assert np.allclose(np.linalg.norm(saloon.edges[:, 2:], axis=1), 1)
    assert not saloon.looks_same(np.pi, np.zeros(3), 0.0, 0.05)
    barrel = cylinder(0.3, 0.9)
    points, normals = sample_surface(*barrel, 30_000, np.random.default_rng(0))
    assert build_model_field("barrel", points, normals).looks_same(1.234, np.zeros(3), 0.0, 0.05)
    bench = merged([box(1.4, 0.4, 0.06), placed(box(0.06, 0.4, 0.4), (0.6, 0, 0.06))])
    points, normals = sample_surface(*bench, 30_000, np.random.default_rng(0))
    assert not build_model_field("bench", points, normals).looks_same(np.pi, np.zeros(3), 0.0, 0.05)


def test_field_refuses_what_is_no_body():
    with pytest.raises(ValueError, match="too few"):
        build_model_field("dot", np.zeros((3, 3)), np.zeros((3, 3)))
    flat = np.c_[np.random.default_rng(0).uniform(0, 1, (100, 2)), np.zeros(100)]
    with pytest.raises(ValueError, match="flat"):
        build_model_field("flat", flat, np.tile([0.0, 0, 1], (100, 1)))
