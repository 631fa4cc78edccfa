"""What a right instance would score in such a cloud: the unit of a score.

Sparse, noisy or wavy clouds support even a perfect fit only in part, and every model loses in its
own way. So the model itself is put on level ground, sampled and disturbed as the cloud is, and
judged at its true pose by the very rules that judge candidates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.model_surface import points_on
from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.judge.hypotheses import Place, refine_poses
from spinpipe.stages.verify.judge.scoring import score_parts
from spinpipe.stages.verify.judge.tolerance import Tolerance
from spinpipe.stages.verify.model.field import ModelField
from spinpipe.stages.verify.model.pose import POSE
from spinpipe.stages.verify.scene.cell_grid import grid_of

INSTANCES = 6
MOST_POINTS = 400_000
"""Of all instances and their ground together; a denser cloud gets fewer of them."""
LEAST = 0.3
"""A part below this says that such a cloud tells nothing of it: it is taken instead."""
WAVES = 8
"""Plane waves that the error of a surface is made of."""


class Reference(NamedTuple):
    """What a right instance of a model gets: medians of its parts, and of the points explained."""

    parts: F64
    points: float


def right_instance(
    field: ModelField, limits: Tolerance, sampling: Sampling, error_m: float, shell_share: float
) -> Reference:
    """Judge instances of the model in such a cloud.

    Parameters
    ----------
    field : the model.
    limits : its tolerances in the cloud.
    sampling : of the cloud.
    error_m : how far surfaces are off at the size of the model, standard deviation.
    shell_share : of the model, see ``tolerance.shell_share``.
    """
    rng = np.random.default_rng(0)  # a number about model and cloud, not part of a run's chance
    half_m = 2.4 * field.reach_m + 2 * limits.coarse_gate_m
    each = sampling.density * (2 * half_m) ** 2
    if each > MOST_POINTS:
        half_m = max(math.sqrt(MOST_POINTS / sampling.density) / 2, 1.2 * field.reach_m)
    count = int(np.clip(MOST_POINTS // max(each, 1.0), 1, INSTANCES))
    parts, explained = [], []
    for _ in range(count):
        pose = np.ones((1, POSE))
        pose[0, :3] = 0.0
        pose[0, 3] = rng.uniform(-np.pi, np.pi)
        points = _instance(field, sampling, error_m, half_m, float(pose[0, 3]), rng)
        place = Place(np.zeros(3), np.zeros(2), float(field.size[2]))
        scene = place.scene(grid_of(points, sampling), 1.5 * half_m)
        fitted, evidence = refine_poses(scene, field, limits, pose)
        height = field.size[2] * fitted[:, 6]
        parts.append(score_parts(evidence, limits, shell_share, 0.0, fitted[:, 2], height)[0])
        explained.append(evidence[0, EVIDENCE.index("explained")])
    return Reference(np.clip(np.median(parts, axis=0), LEAST, 1.0), float(np.median(explained)))


def _instance(
    field: ModelField,
    sampling: Sampling,
    error_m: float,
    half_m: float,
    yaw: float,
    rng: np.random.Generator,
) -> F64:
    """Points of the model at a heading and of the level ground around it that it does not hide."""
    count = max(1, round(points_on(field.samples, sampling.density)))
    rows = rng.integers(0, len(field.samples), count)
    surface = field.samples[rows]
    surface = surface + _error(surface, error_m, field.narrow_m, rng)[:, None] * field.normals[rows]
    ground = np.zeros((rng.poisson(sampling.density * (2 * half_m) ** 2), 3))
    ground[:, :2] = rng.uniform(-half_m, half_m, (len(ground), 2))
    cell = np.floor((ground[:, :2] - field.origin[:2]) / field.voxel_m).astype(int)
    inside = np.all((cell >= 0) & (cell < field.footprint.shape), axis=1)
    hidden = np.zeros(len(ground), bool)
    hidden[inside] = field.footprint[cell[inside, 0], cell[inside, 1]]
    points = np.concatenate([surface, ground[~hidden]])
    cos, sin = math.cos(yaw), math.sin(yaw)
    points = points @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return points + sampling.noise_m * rng.standard_normal(points.shape)


def _error(points: F64, error_m: float, narrow_m: float, rng: np.random.Generator) -> F64:
    """(N,) how far a wavy surface is off at points (N, 3): waves one to four half widths long."""
    if error_m <= 0.0:
        return np.zeros(len(points))
    direction = rng.standard_normal((WAVES, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    length_m = narrow_m * rng.uniform(1.0, 4.0, (WAVES, 1))
    phase = points @ (2 * math.pi * direction / length_m).T + rng.uniform(0, 2 * math.pi, WAVES)
    return error_m * math.sqrt(2.0 / WAVES) * np.cos(phase).sum(axis=1)
