"""Kernels that a test run compiles in two processes at once where there are none, see conftest.

As a program: says so on standard output once those of the registration are there; then come those
of pruning.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.shapes import box, sample_surface
from spinpipe.stages.scan.correlate import build_index, correlate
from spinpipe.stages.scan.image import SpinGrid
from spinpipe.stages.scan.templates import Templates
from spinpipe.stages.verify.judge.hypotheses import coarse_poses, course_of, refine_poses
from spinpipe.stages.verify.judge.tolerance import Tolerance, tolerance
from spinpipe.stages.verify.model.field import ModelField, build_model_field
from spinpipe.stages.verify.scene.cell_grid import CellGrid, grid_of


@cache
def crate() -> tuple[CellGrid, ModelField, Tolerance]:
    """A few points of a crate, the model of it, and limits."""
    points, normals = sample_surface(*box(1.2, 0.8, 1.0), 2000, np.random.default_rng(0))
    field = build_model_field("crate", points, normals, resolution=16, spread=500, probes=20)
    sampling = Sampling(0.1, 0.0)
    return grid_of(points, sampling), field, tolerance(field, 0.0, sampling, 0.0)


def registration() -> None:
    """Compile what fits a model from a start, and gathers evidence."""
    refine_poses(*crate(), np.ones((1, 7)))
    course_of(*crate(), np.ones(7))


def coarse_search() -> None:
    """Compile what finds the starts."""
    coarse_poses(*crate(), top=1.0, keep=1)


def pruning() -> None:
    """Compile the scan that leaves out where nothing can be."""
    points = crate()[0].points
    grid = SpinGrid.of(2.5, 1.0, 0.2)
    templates = Templates.of(grid, [np.ones(grid.shape)])
    correlate(build_index(points), points, templates, min_correlation=0.5)


if __name__ == "__main__":
    registration()
    print("registration", flush=True)
    pruning()
