"""Transforms between the scene as imported, the local frame and the upright world."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from spinpipe.schemas.arrays import F32, F64
from spinpipe.schemas.records import SceneFrame, Upright, Vector


def local_from_scene(frame: SceneFrame) -> F64:
    """(4, 4) T_local_scene: ``local = (scene - origin) * scale``, similar if z has x's unit."""
    T = np.diag([*frame.scale, 1.0])
    T[:3, 3] = -np.asarray(frame.scale) * np.asarray(frame.origin)
    return T


def world_from_scene(frame: SceneFrame, upright: Upright) -> F64:
    """(4, 4) similarity T_world_scene."""
    return upright.T_world_local @ local_from_scene(frame)


def inverse(T: F64) -> F64:
    """(4, 4) T_b_a from T_a_b."""
    return np.asarray(np.linalg.inv(T), np.float64)


def transform(T: F64, points: NDArray[Any]) -> F64:
    """Apply a (4, 4) transform to (N, 3) points, in float64.

    Axis by axis: a matrix product of such shape is slower, and its last digits depend on the
    machine's linear algebra library.
    """
    x, y, z = np.asarray(points, dtype=np.float64).T
    moved = np.empty((len(x), 3))
    for axis in range(3):
        moved[:, axis] = T[axis, 0] * x + T[axis, 1] * y + T[axis, 2] * z + T[axis, 3]
    return moved


def to_world(upright: Upright, local: F32) -> F32:
    """(N, 3) float32 points, local frame -> world: computed in float64, rounded once."""
    return transform(upright.T_world_local, local).astype(np.float32)


def yaw_matrix(heading_deg: float, translation: ArrayLike = (0.0, 0.0, 0.0)) -> F64:
    """(4, 4) pose of an upright object: turned about z, then moved. Quarter turns are exact."""
    turned = math.radians(heading_deg % 90.0)
    cosine, sine = math.cos(turned), math.sin(turned)
    for _ in range(int(heading_deg % 360.0 // 90.0)):
        cosine, sine = -sine, cosine
    T = np.eye(4)
    T[:2, :2] = [[cosine, -sine], [sine, cosine]]
    T[:3, 3] = translation
    return T


def turns(yaw: ArrayLike) -> F64:
    """(..., 2, 2) rotations of x and y by angles (...,), radians."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.stack([cos, -sin, sin, cos], axis=-1).reshape(*np.shape(yaw), 2, 2)


def heading_quaternion(heading_deg: ArrayLike) -> F64:
    """(..., 4) rotation x y z w object -> world of upright objects (...,) with these headings."""
    half = np.radians(np.asarray(heading_deg, np.float64)) / 2.0
    zero = np.zeros_like(half)
    return np.stack([zero, zero, np.sin(half), np.cos(half)], axis=-1)


def rotation_quaternion(T: NDArray[Any]) -> F64:
    """(..., 4) rotation x y z w of transforms (..., 4, 4) that may stretch along their own axes."""
    axes = np.asarray(T, np.float64)[..., :3, :3]
    axes = axes / np.linalg.norm(axes, axis=-2, keepdims=True)
    turns = Rotation.from_matrix(axes.reshape(-1, 3, 3)).as_quat(canonical=True)
    return turns.reshape(*axes.shape[:-2], 4)


def quaternion_matrix(quaternion_xyzw: ArrayLike) -> F64:
    """(N, 3, 3) rotations of quaternions x y z w (N, 4)."""
    return Rotation.from_quat(np.asarray(quaternion_xyzw, np.float64).reshape(-1, 4)).as_matrix()


def heading_deg(T_world_object: F64) -> float:
    """Direction of the object's +x axis about z, degrees in [0, 360)."""
    return float(np.degrees(np.arctan2(T_world_object[1, 0], T_world_object[0, 0])) % 360.0)


def vector(values: NDArray[Any]) -> Vector:
    """Three numbers of an array as a tuple."""
    x, y, z = (float(v) for v in values)
    return x, y, z


def leaning(slopes: NDArray[Any]) -> F64:
    """(3, 3) least rotation that turns z to the normal of a plane of slopes (2,) along x and y.

    [Rodrigues' formula about the horizontal axis of the tilt.]
    """
    a, b = float(slopes[0]), float(slopes[1])
    cos = 1.0 / np.sqrt(1.0 + a * a + b * b)
    x, y = -a * cos, -b * cos  # of the normal
    share = 1.0 / (1.0 + cos)
    return np.array(
        [
            [1.0 - share * x * x, -share * x * y, x],
            [-share * x * y, 1.0 - share * y * y, y],
            [-x, -y, cos],
        ]
    )
