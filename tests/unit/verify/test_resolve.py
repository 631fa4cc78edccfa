import numpy as np
import pytest

from spinpipe.stages.verify.judge.resolve import overlap, resolve


def test_overlap_of_boxes():
    size = np.array([4.0, 2.0, 1.5])
    here = np.array([0.0, 0.0, 0.0, 0.3])
    assert overlap(here, size, here, size) == pytest.approx(1.0)
    assert overlap(here, size, here + [0, 0, 0, np.pi], size) == pytest.approx(1.0)
    assert overlap(here, size, here + [9, 0, 0, 0], size) == 0.0
    assert overlap(here, size, here + [0, 0, 1.5, 0], size) == 0.0
    assert overlap(here, size, here + [0, 0, 0.75, 0], size) == pytest.approx(0.5)


def test_overlap_matches_sampling():
    rng = np.random.default_rng(5)
    for _ in range(20):
        a, b = rng.uniform(-1, 1, (2, 4)) * [1, 1, 0.5, np.pi]
        size_a, size_b = rng.uniform(0.5, 3, (2, 3))
        points = rng.uniform(-0.5, 0.5, (200_000, 3)) * size_a + [0, 0, size_a[2] / 2]
        world = _turn(points, a[3]) + a[:3]
        inside = _turn(world - b[:3], -b[3])
        hit = np.all(np.abs(inside[:, :2]) < size_b[:2] / 2, axis=1)
        hit &= (inside[:, 2] > 0) & (inside[:, 2] < size_b[2])
        expected = hit.mean() * size_a.prod() / min(size_a.prod(), size_b.prod())
        assert overlap(a, size_a, b, size_b) == pytest.approx(expected, abs=0.01)


def _turn(points, yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def test_better_one_stays_whatever_the_order():
    poses = np.array([[0, 0, 0, 0], [0.5, 0, 0, 0.1], [4.5, 0, 0, 0], [4.6, 0.2, 0, np.pi]])
    sizes = np.tile([4.0, 1.8, 1.5], (4, 1))
    scores = np.array([0.7, 0.9, 0.8, 0.6])
    assert resolve(poses, sizes, scores).tolist() == [1, -1, -1, 2]
    order = np.array([3, 1, 0, 2])
    again = resolve(poses[order], sizes[order], scores[order])
    assert again.tolist() == [3, -1, 1, -1]


def test_neighbours_may_touch_and_nothing_is_nothing():
    poses = np.array([[0, 0, 0, 0], [0, 1.7, 0, 0]])
    sizes = np.tile([4.0, 1.8, 1.5], (2, 1))
    assert (resolve(poses, sizes, np.array([0.9, 0.8])) == -1).all()
    assert len(resolve(np.empty((0, 4)), np.empty((0, 3)), np.empty(0))) == 0
