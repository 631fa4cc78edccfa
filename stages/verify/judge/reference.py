"""What a right instance would score in a cloud of this density and noise: the unit of a score.

Sparse or noisy clouds support even a perfect fit only in part, and every model loses in its own
way. So the model itself is put on level ground, sampled and disturbed as the cloud is, and judged
at its true pose by the very rules that judge candidates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.model_surface import points_on
from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.judge.hypotheses import refine_poses
from spinpipe.stages.verify.judge.scoring import score_parts
from spinpipe.stages.verify.judge.tolerance import Tolerance
from spinpipe.stages.verify.model.field import ModelField
from spinpipe.stages.verify.model.lookup import POSE
from spinpipe.stages.verify.scene.surroundings import build_surroundings

F64 = NDArray[np.float64]

INSTANCES = 6
MOST_POINTS = 400_000
"""Of all instances and their ground together; a denser cloud gets fewer of them."""
LEAST = 0.3
"""A part below this says that such a cloud tells nothing of it: it is taken instead."""


class Reference(NamedTuple):
    """What a right instance of a model gets: medians of its parts, and of the points explained."""

    parts: F64
    points: float


def right_instance(
    field: ModelField, limits: Tolerance, sampling: Sampling, shell_share: float
) -> Reference:
    """Judge instances of the model in such a cloud.

    Parameters
    ----------
    field : the model.
    limits : its tolerances in the cloud.
    sampling : of the cloud.
    shell_share : of the model, see ``tolerance.shell_share``.
    """
    rng = np.random.default_rng(0)  # a number about model and cloud, not part of a run's chance
    ground_m = 1.4 * field.reach_m
    half_m = field.reach_m + ground_m + 2 * limits.coarse_gate_m
    each = sampling.density * (2 * half_m) ** 2
    if each > MOST_POINTS:
        half_m = max(math.sqrt(MOST_POINTS / sampling.density) / 2, 1.2 * field.reach_m)
    count = int(np.clip(MOST_POINTS // max(each, 1.0), 1, INSTANCES))
    poses = np.ones((count, POSE))
    poses[:, 0] = 2 * half_m * np.arange(count)
    poses[:, 1:3] = 0.0
    poses[:, 3] = rng.uniform(-np.pi, np.pi, count)
    points = np.concatenate([_instance(field, sampling, half_m, pose, rng) for pose in poses])
    scene = build_surroundings(points, sampling, ground_m)
    fitted, evidence = refine_poses(scene, field, limits, poses, threads=1)
    above = fitted[:, 2] - scene.ground_at(fitted[:, :2])
    height = field.size[2] * fitted[:, 6]
    parts = score_parts(evidence, limits, shell_share, 0.0, above, height)
    points = float(np.median(evidence[:, EVIDENCE.index("explained")]))
    return Reference(np.clip(np.median(parts, axis=0), LEAST, 1.0), points)


def _instance(
    field: ModelField, sampling: Sampling, half_m: float, pose: F64, rng: np.random.Generator
) -> F64:
    """Points of the model at a pose and of the level ground around it that it does not hide."""
    count = max(1, round(points_on(field.samples, sampling.density)))
    surface = field.samples[rng.integers(0, len(field.samples), count)]
    ground = np.zeros((rng.poisson(sampling.density * (2 * half_m) ** 2), 3))
    ground[:, :2] = rng.uniform(-half_m, half_m, (len(ground), 2))
    cell = np.floor((ground[:, :2] - field.origin[:2]) / field.voxel_m).astype(int)
    inside = np.all((cell >= 0) & (cell < field.footprint.shape), axis=1)
    hidden = np.zeros(len(ground), bool)
    hidden[inside] = field.footprint[cell[inside, 0], cell[inside, 1]]
    points = np.concatenate([surface, ground[~hidden]])
    cos, sin = math.cos(pose[3]), math.sin(pose[3])
    points = points @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return points + pose[:3] + sampling.noise_m * rng.standard_normal(points.shape)
