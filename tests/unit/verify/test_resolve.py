import numpy as np
import pytest

from spinpipe.stages.verify.judge.resolve import common_m3, resolve


def test_common_volume_of_boxes():
    size = np.array([4.0, 2.0, 1.5])
    here = np.array([0.0, 0.0, 0.0, 0.3])
    assert common_m3(here, size, here, size) == pytest.approx(12.0)
    assert common_m3(here, size, here + [0, 0, 0, np.pi], size) == pytest.approx(12.0)
    assert common_m3(here, size, here + [9, 0, 0, 0], size) == 0.0
    assert common_m3(here, size, here + [0, 0, 1.5, 0], size) == 0.0
    assert common_m3(here, size, here + [0, 0, 0.75, 0], size) == pytest.approx(6.0)


def test_common_volume_matches_sampling():
    rng = np.random.default_rng(5)
    for _ in range(20):
        a, b = rng.uniform(-1, 1, (2, 4)) * [1, 1, 0.5, np.pi]
        size_a, size_b = rng.uniform(0.5, 3, (2, 3))
        points = rng.uniform(-0.5, 0.5, (200_000, 3)) * size_a + [0, 0, size_a[2] / 2]
        world = _turn(points, a[3]) + a[:3]
        inside = _turn(world - b[:3], -b[3])
        hit = np.all(np.abs(inside[:, :2]) < size_b[:2] / 2, axis=1)
        hit &= (inside[:, 2] > 0) & (inside[:, 2] < size_b[2])
        volume = size_a.prod()
        expected = pytest.approx(hit.mean() * volume, abs=0.01 * volume)
        assert common_m3(a, size_a, b, size_b) == expected


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


def test_what_lies_across_a_row_takes_little_of_each_and_stands_nowhere():
    row = np.array([[0, 3.0 * k, 0, 0] for k in range(5)])
    poses = np.vstack([row, [0, 6.0, 0, np.pi / 2]])
    sizes = np.tile([18.0, 2.7, 3.0], (6, 1))
    displaced_by = resolve(poses, sizes, np.array([0.8, 0.8, 0.8, 0.8, 0.8, 0.7]))
    assert (displaced_by[:5] == -1).all()
    assert displaced_by[5] >= 0


def test_of_one_candidate_one_hypothesis_stands_and_the_next_where_the_best_is_taken():
    # the second candidate fits best where the first stands, and second best beside it
    poses = np.array([[0, 0, 0, 0], [0.1, 0, 0, 0], [0, 2.5, 0, 0], [0, 5.0, 0, 0]])
    sizes = np.tile([4.0, 1.8, 1.5], (4, 1))
    scores = np.array([0.9, 0.8, 0.7, 0.6])
    candidate = np.array([0, 1, 1, 1])
    assert resolve(poses, sizes, scores, candidate=candidate).tolist() == [-1, 0, -1, 2]
