"""Boxes of detections as every drawing of them has them: leaning as the objects do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import Detection
from spinpipe.stages.geometry.frames import rotation_quaternion


class Boxes(NamedTuple):
    """Boxes in the world; lengths in metres."""

    centers: F64
    """(N, 3)."""
    sizes: F64
    """(N, 3) length, width, height."""
    quaternions: F64
    """(N, 4) rotation x y z w object -> world."""
    forward: F64
    """(N, 3) unit vectors along the objects' +x."""
    up: F64
    """(N, 3) unit vectors along their +z."""

    @property
    def tops(self) -> F64:
        """(N, 3) middles of the upper faces."""
        return self.centers + self.up * self.sizes[:, 2:] / 2


def boxes_of(detections: Sequence[Detection]) -> Boxes:
    """The fitted boxes; their base centres are the detections' positions."""
    T = np.array([d.T_world_object for d in detections]).reshape(-1, 4, 4)
    axes = T[:, :3, :3] / np.linalg.norm(T[:, :3, :3], axis=1, keepdims=True)
    sizes = np.array([d.size_m for d in detections], np.float64).reshape(-1, 3)
    base = np.array([d.position_world for d in detections], np.float64).reshape(-1, 3)
    forward, up = axes[:, :, 0], axes[:, :, 2]
    return Boxes(base + up * sizes[:, 2:] / 2, sizes, rotation_quaternion(T), forward, up)
