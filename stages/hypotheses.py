"""Hypotheses about candidates: compiled batches of coarse search, refinement and evidence.

Each candidate is worked on alone and by one thread, so neither the number of threads nor the other
candidates change its result.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.hypothesis_kernels import coarse_batch, refine_batch
from spinpipe.stages.model_field import ModelField
from spinpipe.stages.registration import POSE
from spinpipe.stages.spin_kernel import map_threads
from spinpipe.stages.surroundings import Surroundings
from spinpipe.stages.tolerance import Tolerance

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

EVIDENCE = (
    "converged",
    "supported",
    "contradicted",
    "empty",
    "covered",
    "sheltered",
    "claimed",
    "explained",
    "inside",
    "rms_m",
    "drop",
    "ring",
    "side_supported",
    "side_contradicted",
)
"""Columns of the evidence of a hypothesis, see ``evidence.py``."""

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
    top = _top_xy(model)

    def work(part: slice) -> None:
        coarse_batch(
            scene.points,
            scene.weights,
            scene.heights,
            scene.start,
            scene.cells,
            scene.corner,
            scene.cell_m,
            places[part],
            ground[part],
            top,
            model.samples,
            model.origin,
            model.voxel_m,
            model.nearest,
            model.footprint,
            model.size,
            limits.coarse_gate_m,
            limits.step_m,
            limits.headings,
            limits.offset_m,
            limits.low_m,
            limits.stretch,
            poses[part],
            gains[part],
        )

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

    def work(part: slice) -> None:
        refine_batch(
            scene.points,
            scene.weights,
            scene.heights,
            scene.start,
            scene.cells,
            scene.corner,
            scene.cell_m,
            scene.sampling.density,
            ground[part],
            model.samples,
            model.normals,
            model.probes,
            model.seen_weight,
            model.samples[model.side_probes],
            model.origin,
            model.voxel_m,
            model.nearest,
            model.solid,
            model.size,
            model.edges,
            model.depth_edge,
            model.outline,
            model.outline_normals,
            model.outline_height,
            limits.gate_m,
            limits.sharp_m,
            limits.coarse_gate_m,
            limits.low_m,
            limits.stretch,
            poses[part],
            evidence[part],
        )

    for _ in map_threads(work, _parts(len(starts)), threads):
        pass
    return poses, evidence


def _top_xy(model: ModelField) -> F64:
    """Horizontal position of the model's topmost surface, as the spin image takes it."""
    top = model.samples[model.samples[:, 2] > 0.99 * model.size[2]]
    return top[:, :2].mean(axis=0)


def _parts(count: int) -> list[slice]:
    return [slice(i, min(i + _CHUNK, count)) for i in range(0, count, _CHUNK)]
