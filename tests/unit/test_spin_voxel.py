"""Coarse to fine: what it keeps, what it leaves out."""

from __future__ import annotations

import numpy as np

from spinpipe.stages.spin_image import SpinGrid, template_from_cloud
from spinpipe.stages.spin_kernel import BELOW, ScanWork, build_index, correlate
from spinpipe.stages.spin_voxel import correlate_near_promising

GRID = SpinGrid(2.0, 0.8, 0.1)


def dome(rng, n=6000):
    """Something round that stands on rough ground."""
    ground = rng.random((n, 3)) * [16, 12, 0] + rng.normal(0, 0.02, (n, 1)) * [0, 0, 1]
    cap = rng.normal(size=(n, 3))
    cap /= np.linalg.norm(cap, axis=1)[:, None]
    cap = abs(cap) * rng.choice([-1.0, 1.0], (n, 3)) * [1.5, 1.5, 0]
    cap[:, 2] = np.sqrt(np.maximum(2.25 - (cap[:, :2] ** 2).sum(axis=1), 0)) * 0.8
    return cap, np.vstack([ground, cap + [6, 6, 0]])


def coarse_of(cloud, side_m):
    return cloud[np.unique(np.floor(cloud / side_m), axis=0, return_index=True)[1]]


def test_hits_near_promising_origins_are_those_of_the_full_scan():
    model, cloud = dome(np.random.default_rng(0))
    index, template = build_index(cloud), template_from_cloud(model, GRID)
    every, fine = ScanWork(), ScanWork()
    full = correlate(index, cloud, [template], work=every)[0]
    hits = full >= np.float32(0.6)
    steps = []
    found = correlate_near_promising(
        index, cloud, coarse_of(cloud, 0.2), [template], 2,
        min_correlation=0.6, reach_m=0.36, advance=steps.append, work=fine,
    )[0]  # fmt: skip
    kept = found > BELOW
    assert hits.sum() > 20
    assert not (kept & ~hits).any()
    np.testing.assert_array_equal(found[kept], full[kept])
    assert kept.sum() >= 0.8 * hits.sum()
    assert fine.visits < every.visits / 2
    assert sum(steps) == len(cloud)


def test_every_origin_chosen_is_the_full_scan():
    model, cloud = dome(np.random.default_rng(1), 1500)
    index, template = build_index(cloud), template_from_cloud(model, GRID)
    full = correlate(index, cloud, [template], min_correlation=0.5)
    found = correlate_near_promising(
        index, cloud, cloud, [template], min_correlation=0.5, reach_m=0.1, margin=0.0
    )
    np.testing.assert_array_equal(found, full)


def test_nothing_to_choose_from():
    index, template = build_index(np.zeros((5, 3))), template_from_cloud(np.eye(3), GRID)
    for origins, coarse in [
        (np.zeros((0, 3)), np.zeros((0, 3))),
        (np.ones((4, 3)), np.ones((1, 3))),
    ]:
        found = correlate_near_promising(
            index, origins, coarse, [template], min_correlation=0.5, reach_m=1.0
        )
        assert found.shape == (1, len(origins))
        assert (found == BELOW).all()
