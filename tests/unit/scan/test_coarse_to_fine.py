"""Coarse to fine: what it keeps, what it leaves out."""

from __future__ import annotations

import numpy as np
import pytest

from spinpipe.stages.scan.coarse_to_fine import correlate_coarse_to_fine
from spinpipe.stages.scan.correlate import BELOW, ScanWork, build_index, correlate
from spinpipe.stages.scan.image import SpinGrid
from spinpipe.stages.scan.templates import Templates, object_image

GRID = SpinGrid.of(2.0, 0.8, 0.1)


def dome(rng, n=6000):
    """Something round that stands on rough ground."""
    ground = rng.random((n, 3)) * [16, 12, 0] + rng.normal(0, 0.02, (n, 1)) * [0, 0, 1]
    cap = rng.normal(size=(n, 3))
    cap /= np.linalg.norm(cap, axis=1)[:, None]
    cap = abs(cap) * rng.choice([-1.0, 1.0], (n, 3)) * [1.5, 1.5, 0]
    cap[:, 2] = np.sqrt(np.maximum(2.25 - (cap[:, :2] ** 2).sum(axis=1), 0)) * 0.8
    return cap, np.vstack([ground, cap + [6, 6, 0]])


def test_what_is_scored_is_scored_as_by_the_full_scan():
    model, cloud = dome(np.random.default_rng(0))
    cloud = cloud.astype(np.float32)
    index, template = build_index(cloud), Templates.of(GRID, [object_image(model, GRID)])
    every, fine = ScanWork(), ScanWork()
    full = correlate(index, cloud, template, work=every)[0]
    hits = full >= np.float32(0.6)
    steps = []
    found = correlate_coarse_to_fine(
        index, cloud, np.ones(len(cloud), bool), template, 2,
        min_correlation=0.6, voxel_m=0.25, advance=steps.append, work=fine,
    )[0]  # fmt: skip
    scored = found > BELOW
    assert hits.sum() > 20
    np.testing.assert_array_equal(found[scored], full[scored])
    assert scored[hits].mean() >= 0.95
    assert fine.visits < every.visits / 2
    assert sum(steps) == len(cloud)


def test_only_what_is_asked_for_comes_back():
    model, cloud = dome(np.random.default_rng(2), 3000)
    cloud = cloud.astype(np.float32)
    index, template = build_index(cloud), Templates.of(GRID, [object_image(model, GRID)])
    asked = cloud[:, 0] < 6
    whole, part = (
        correlate_coarse_to_fine(index, cloud, own, template, min_correlation=0.5, voxel_m=0.25)
        for own in (np.ones(len(cloud), bool), asked)
    )
    np.testing.assert_array_equal(part, whole[:, asked])


def test_a_wide_margin_in_one_voxel_is_the_full_scan():
    model, cloud = dome(np.random.default_rng(1), 1500)
    cloud = cloud.astype(np.float32)
    index, template = build_index(cloud), Templates.of(GRID, [object_image(model, GRID)])
    full = correlate(index, cloud, template)
    found = correlate_coarse_to_fine(
        index, cloud, np.ones(len(cloud), bool), template,
        min_correlation=0.1, voxel_m=100.0, margin=1.1,
    )  # fmt: skip
    np.testing.assert_array_equal(found, full)


@pytest.mark.parametrize("count", [0, 4])
def test_nothing_to_find(count):
    index, template = (
        build_index(np.zeros((5, 3))),
        Templates.of(GRID, [object_image(np.eye(3), GRID)]),
    )
    origins = np.ones((count, 3), np.float32)
    found = correlate_coarse_to_fine(
        index, origins, np.ones(count, bool), template,
        min_correlation=0.5, voxel_m=1.0, pruned=True,
    )  # fmt: skip
    assert found.shape == (1, count)
    assert (found == BELOW).all()
