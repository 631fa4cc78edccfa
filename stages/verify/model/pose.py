"""A pose as kernels see it, and the ways between the scene and the object's axes."""

from __future__ import annotations

import math
from typing import NamedTuple

from spinpipe.stages.compiled import inner

POSE = 7
"""Numbers of a pose in an array: the first seven fields of ``Pose``."""


class Pose(NamedTuple):
    """Where a model stands: upright in the frame of its support."""

    x: float
    """This to ``z``: base centre, metres."""
    y: float
    z: float
    yaw: float
    """Radians, of the object's +x."""
    stretch_x: float
    """This to ``stretch_z``: along the object's axes."""
    stretch_y: float
    stretch_z: float
    cos: float
    """This and ``sin``: of the yaw."""
    sin: float


@inner
def pose_of(row):
    """Pose of its numbers (7,)."""
    return Pose(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], math.cos(row[3]), math.sin(row[3])
    )


@inner
def to_object(pose, x, y, z):
    """A point in the object's axes, not unstretched."""
    dx, dy = x - pose.x, y - pose.y
    return pose.cos * dx + pose.sin * dy, pose.cos * dy - pose.sin * dx, z - pose.z


@inner
def to_scene(pose, ux, uy):
    """Where a place in the object's axes, stretched already, is in the scene."""
    return pose.x + pose.cos * ux - pose.sin * uy, pose.y + pose.sin * ux + pose.cos * uy
