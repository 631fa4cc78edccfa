"""Compiles half of the kernels while a test run compiles the others, see ``finished_yard``.

Says so on standard output once those of the registration are there; then come those of pruning.
"""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.shapes import box, sample_surface
from spinpipe.stages.scan.correlate import build_index, correlate
from spinpipe.stages.scan.image import SpinGrid
from spinpipe.stages.scan.templates import Templates
from spinpipe.stages.verify.judge.hypotheses import course_of, refine_poses
from spinpipe.stages.verify.judge.tolerance import tolerance
from spinpipe.stages.verify.model.field import build_model_field
from spinpipe.stages.verify.scene.cell_grid import grid_of

points, normals = sample_surface(*box(1.2, 0.8, 1.0), 2000, np.random.default_rng(0))
field = build_model_field("crate", points, normals, resolution=16, spread=500, probes=20)
sampling = Sampling(0.1, 0.0)
around = grid_of(points, sampling), field, tolerance(field, 0.0, sampling, 0.0)
refine_poses(*around, np.ones((1, 7)))
course_of(*around, np.ones(7))
print("registration", flush=True)
grid = SpinGrid.of(2.5, 1.0, 0.2)
templates = Templates.of(grid, [np.ones(grid.shape)])
correlate(build_index(points), points, templates, min_correlation=0.5)
