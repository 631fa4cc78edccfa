"""Components of the tessellation, against single linkage computed from all distances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from spinpipe.stages.cluster.delaunay import delaunay_components


def linked(points: np.ndarray, max_edge_m: float) -> np.ndarray:
    """Components of the graph of all pairs nearer than the limit."""
    return connected_components(cdist(points, points) <= max_edge_m, directed=False)[1]


def same_partition(a: np.ndarray, b: np.ndarray) -> bool:
    return (
        len({*zip(a.tolist(), b.tolist(), strict=True)}) == len({*a.tolist()}) == len({*b.tolist()})
    )


@given(
    count=st.integers(1, 60),
    dimensions=st.integers(0, 3),
    seed=st.integers(0, 10**6),
    max_edge_m=st.floats(0.01, 3),
)
def test_components_are_those_of_single_linkage(
    count: int, dimensions: int, seed: int, max_edge_m: float
) -> None:
    points = np.random.default_rng(seed).normal(size=(count, 3)) * (np.arange(3) < dimensions)
    assert same_partition(delaunay_components(points, max_edge_m), linked(points, max_edge_m))


@given(
    grid=hnp.arrays(np.int8, st.tuples(st.integers(1, 40), st.just(3)), elements=st.integers(0, 4)),
    max_edge_m=st.sampled_from([0.5, 1.2, 1.5, 2.2]),
)
def test_grids_and_equal_points_are_no_exception(grid: np.ndarray, max_edge_m: float) -> None:
    points = grid.astype(np.float32)
    assert same_partition(delaunay_components(points, max_edge_m), linked(points, max_edge_m))


def test_far_from_the_origin_nothing_changes() -> None:
    points = np.random.default_rng(0).normal(size=(200, 3))
    near = delaunay_components(points, 0.4)
    np.testing.assert_array_equal(delaunay_components(points + [4e6, 5e5, 100], 0.4), near)


def test_no_points_have_no_components() -> None:
    assert delaunay_components(np.empty((0, 3), np.float32), 1.0).shape == (0,)


def test_components_are_numbered_by_first_appearance() -> None:
    points = np.array([[9, 0, 0], [0, 0, 0], [9.5, 0, 0], [0.5, 0, 0], [5, 5, 5]], np.float32)
    assert delaunay_components(points, 1.0).tolist() == [0, 1, 0, 1, 2]


@pytest.mark.parametrize("slope", [0.0, 1e-6, 1e-3])
def test_hits_on_a_nearly_flat_roof_hold_together(slope: float) -> None:
    rng = np.random.default_rng(1)
    roof = np.column_stack([rng.uniform(0, 2, (100, 2)), slope * rng.normal(size=100)])
    assert same_partition(delaunay_components(roof, 0.35), linked(roof, 0.35))
