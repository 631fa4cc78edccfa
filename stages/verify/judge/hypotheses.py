"""Hypotheses about candidates: batches of coarse search, refinement and evidence on threads.

Each candidate is worked on alone and by one thread, so neither the number of threads nor the other
candidates change its result.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.threads import map_threads
from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.fit.registration import PASSES, STEPS
from spinpipe.stages.verify.judge.kernels import coarse_batch, refine_batch, refine_course
from spinpipe.stages.verify.judge.tolerance import Tolerance
from spinpipe.stages.verify.model.field import ModelField
from spinpipe.stages.verify.model.lookup import POSE, field_arrays
from spinpipe.stages.verify.scene.surroundings import Surroundings

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_CHUNK = 8


def coarse_poses(
    scene: Surroundings,
    model: ModelField,
    limits: Tolerance,
    places: F64,
    keep: int,
    threads: int,
) -> tuple[F64, F64]:
    """The best distinct coarse poses of a model at each candidate.

    Parameters
    ----------
    places : (C, 3), candidates: where the model's topmost point may be, world.
    keep : how many poses to keep of each.

    Returns
    -------
    poses : (C, keep, 7)
    gains : (C, keep), ``coarse_fit`` of each; 0 where there is no pose.
    """
    poses = np.zeros((len(places), keep, POSE))
    gains = np.zeros((len(places), keep))
    ground = scene.ground_at(places[:, :2])
    grid, field = scene.grid, field_arrays(model)

    def work(part: slice) -> None:
        coarse_batch(grid, field, limits, places[part], ground[part], poses[part], gains[part])

    for _ in map_threads(work, _parts(len(places)), threads):
        pass
    return poses, gains


def refine_poses(
    scene: Surroundings,
    model: ModelField,
    limits: Tolerance,
    starts: F64,
    threads: int,
) -> tuple[F64, F64]:
    """Register the model from each start to convergence and gather the evidence there.

    Parameters
    ----------
    starts : (S, 7)

    Returns
    -------
    poses : (S, 7)
    evidence : (S, len(EVIDENCE))
    """
    poses = starts.copy()
    evidence = np.zeros((len(starts), len(EVIDENCE)))
    ground = scene.ground_at(starts[:, :2])
    grid, field = scene.grid, field_arrays(model)

    def work(part: slice) -> None:
        refine_batch(grid, field, limits, ground[part], poses[part], evidence[part])

    for _ in map_threads(work, _parts(len(starts)), threads):
        pass
    return poses, evidence


@dataclass(frozen=True, eq=False)
class Course:
    """How a registration went: (I, 7) poses and (I,) residuals before each step and at the end."""

    poses: F64
    rms_m: F64


def course_of(scene: Surroundings, model: ModelField, limits: Tolerance, start: F64) -> Course:
    """The way of ``refine_poses`` from one start (7,)."""
    poses, rms_m = np.empty((PASSES * STEPS + 1, POSE)), np.empty(PASSES * STEPS + 1)
    ground_z = float(scene.ground_at(start[None, :2])[0])
    count = refine_course(scene.grid, field_arrays(model), limits, ground_z, start, poses, rms_m)
    return Course(poses[:count], rms_m[:count])


def _parts(count: int) -> list[slice]:
    return [slice(i, min(i + _CHUNK, count)) for i in range(0, count, _CHUNK)]
