"""What things stand on: levels over one another, ramps, edges, stray points below."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.support import find_support, find_surfaces, has_support

SAMPLING = Sampling(0.1, 0.005)
REACH_M, GAP_M = 3.0, 0.7


def plane(rng, low, high, z, slopes=(0.0, 0.0), density=100):
    low, high = np.array(low, float), np.array(high, float)
    xy = rng.uniform(low, high, (int(np.prod(high - low) * density), 2))
    return np.c_[xy, z + xy @ slopes + rng.normal(0, 0.005, len(xy))]


def support_at(cloud, place, base, slack=0.25):
    surfaces = find_surfaces(cloud, SAMPLING, REACH_M, GAP_M)
    found = find_support(np.array([[*place, base]]), np.array([base]), surfaces, np.array([slack]))
    return tuple(float(v[0]) for v in found)


@given(slope=st.floats(0, 0.5), turn=st.floats(0, 6.28))
@settings(max_examples=20)
def test_a_ramp_is_a_support_with_its_slope(slope, turn):
    slopes = slope * np.array([np.cos(turn), np.sin(turn)])
    cloud = plane(np.random.default_rng(0), (-8, -8), (8, 8), 2.0, slopes)
    height, a, b, found = support_at(cloud, (1.0, -1.0), 2.0 + slopes @ [1.0, -1.0])
    assert found == 1
    assert height == pytest.approx(2.0 + slopes @ [1.0, -1.0], abs=0.15)
    assert np.hypot(a - slopes[0], b - slopes[1]) < 0.03


def test_the_level_near_the_base_counts_not_the_lowest():
    rng = np.random.default_rng(1)
    street, deck = plane(rng, (-9, -9), (9, 9), -17.0), plane(rng, (-9, -9), (1, 9), 0.0)
    cloud = np.concatenate([street, deck])
    for base in (0.0, -17.0):
        height, a, b, found = support_at(cloud, (0.0, 0.0), base)
        assert (found, abs(height - base) < 0.03, np.hypot(a, b) < 0.02) == (1, True, True)
    assert support_at(cloud, (0.0, 0.0), -8.0)[3] == 0


def test_stray_points_below_are_no_support():
    rng = np.random.default_rng(2)
    ground = plane(rng, (-9, -9), (9, 9), 0.0)
    strays = np.c_[rng.uniform(-9, 9, (600, 2)), rng.uniform(-25, -3, 600)]
    height, *_, found = support_at(np.concatenate([ground, strays]), (0.0, 0.0), 0.0)
    assert found == 1
    assert abs(height) < 0.03


def test_only_points_at_a_height_above_a_surface_may_be_tops():
    rng = np.random.default_rng(3)
    cloud = np.concatenate([plane(rng, (-9, -9), (9, 9), 0.0), plane(rng, (-9, -9), (9, 9), 5.0)])
    surfaces = find_surfaces(cloud, SAMPLING, REACH_M, GAP_M)
    tops = np.array([[0, 0, 1.4], [0, 0, 6.5], [0, 0, 3.0], [0, 0, 9.0], [3, 3, 0.2]])
    found = has_support(tops, surfaces, np.array([[1.2, 1.7]]))
    assert found.tolist() == [True, True, False, False, False]
