"""One candidate: where a model may stand there, where it fits best, and what speaks for it.

Each candidate is looked at in the frame of the support it stands on: its place at the origin, z
along the support's normal. Each is worked on alone and by one thread, so neither the number of
threads nor the other candidates change its result.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.geometry.frames import leaning
from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.fit.registration import PASSES, STEPS
from spinpipe.stages.verify.judge.kernels import coarse_fits, course, local_scene, refined
from spinpipe.stages.verify.judge.tolerance import Tolerance
from spinpipe.stages.verify.model.field import ModelField
from spinpipe.stages.verify.model.pose import POSE
from spinpipe.stages.verify.scene.cell_grid import CellGrid


class Place(NamedTuple):
    """Where a candidate stands: T_world_support, and how high above it the candidate is."""

    origin: F64
    """(3,) world: the candidate's x and y, on the support."""
    lean: F64
    """(2,) slopes of the support along x and y."""
    top: float
    """Height of the candidate above the support, metres."""

    @property
    def axes(self) -> F64:
        """(3, 3) axes of the support's frame as columns, world."""
        return leaning(self.lean)

    def scene(self, grid: CellGrid, radius_m: float) -> CellGrid:
        """The points around, in the frame of the support."""
        return local_scene(grid, self.origin, self.axes, radius_m)

    def to_world(self, poses: F64) -> F64:
        """Poses (S, 7) of the support's frame in the world, leaning with the support."""
        moved = poses.copy()
        moved[:, :3] = poses[:, :3] @ self.axes.T + self.origin
        return moved

    def from_world(self, poses: F64) -> F64:
        """The inverse of ``to_world``."""
        moved = poses.copy()
        moved[:, :3] = (poses[:, :3] - self.origin) @ self.axes
        return moved


def T_world_object(pose: F64, lean: F64) -> F64:
    """(4, 4) of a pose (7,), with the stretch, on a support of slopes (2,)."""
    T = np.eye(4)
    cos, sin = math.cos(pose[3]), math.sin(pose[3])
    T[:3, :3] = leaning(lean) @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) * pose[4:7]
    T[:3, 3] = pose[:3]
    return T


def coarse_poses(
    scene: CellGrid, model: ModelField, limits: Tolerance, top: float, keep: int
) -> tuple[F64, F64]:
    """The best distinct coarse poses of a model at a candidate.

    Parameters
    ----------
    scene : around the candidate, in the frame of its support.
    top : height of the candidate above the support: of the model's top.
    keep : how many poses to keep.

    Returns
    -------
    poses : (keep, 7)
    gains : (keep,), ``coarse_fit`` of each; 0 where there is no pose.
    """
    poses, gains = np.zeros((keep, POSE)), np.zeros(keep)
    coarse_fits(scene, model, limits, top, poses, gains)
    return poses, gains


def refine_poses(
    scene: CellGrid, model: ModelField, limits: Tolerance, starts: F64
) -> tuple[F64, F64]:
    """Register the model from each start (S, 7) to convergence and gather the evidence there.

    Returns
    -------
    poses : (S, 7)
    evidence : (S, len(EVIDENCE))
    """
    poses, evidence = starts.copy(), np.zeros((len(starts), len(EVIDENCE)))
    refined(scene, model, limits, poses, evidence)
    return poses, evidence


@dataclass(frozen=True, eq=False)
class Course:
    """How a registration went: (I, 7) poses and (I,) residuals before each step and at the end."""

    poses: F64
    rms_m: F64


def course_of(scene: CellGrid, model: ModelField, limits: Tolerance, start: F64) -> Course:
    """The way of ``refine_poses`` from one start (7,)."""
    poses, rms_m = np.empty((PASSES * STEPS + 1, POSE)), np.empty(PASSES * STEPS + 1)
    count = course(scene, model, limits, start, poses, rms_m)
    return Course(poses[:count], rms_m[:count])
