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
    axes: F64
    """(N, 3, 3) unit vectors along the objects' x, y and z, as columns."""

    @property
    def forward(self) -> F64:
        """(N, 3) unit vectors along the objects' +x."""
        return self.axes[:, :, 0]

    @property
    def tops(self) -> F64:
        """(N, 3) middles of the upper faces."""
        return self.centers + self.axes[:, :, 2] * self.sizes[:, 2:] / 2

    @property
    def corners(self) -> F64:
        """(N, 8, 3): base from ahead on the left counter-clockwise, then the top."""
        square = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
        signs = np.array([(x, y, z) for z in (-1, 1) for x, y in square])
        offsets = signs * self.sizes[:, None] / 2
        return self.centers[:, None] + offsets @ self.axes.transpose(0, 2, 1)


def boxes_of(detections: Sequence[Detection]) -> Boxes:
    """The fitted boxes; their base centres are the detections' positions."""
    T = np.array([d.T_world_object for d in detections]).reshape(-1, 4, 4)
    axes = T[:, :3, :3] / np.linalg.norm(T[:, :3, :3], axis=1, keepdims=True)
    sizes = np.array([d.size_m for d in detections], np.float64).reshape(-1, 3)
    base = np.array([d.position_world for d in detections], np.float64).reshape(-1, 3)
    return Boxes(base + axes[:, :, 2] * sizes[:, 2:] / 2, sizes, rotation_quaternion(T), axes)
