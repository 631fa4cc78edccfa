"""Records of poses, which travel as messages of Foxglove: of cameras, a sensor, instances.

Frames: see ``records``.
"""

from __future__ import annotations

from dataclasses import dataclass

from spinpipe.schemas.arrays import F64, I64


@dataclass(frozen=True)
class Poses:
    """Where things are and how they are turned."""

    positions: F64
    """(N, 3) metres."""
    quaternions_xyzw: F64
    """(N, 4) rotation from the thing's own frame."""


@dataclass(frozen=True)
class Cameras(Poses):
    """Where the photos were taken from, local frame; a camera looks along its +z, its -y is up."""

    names: tuple[str, ...]
    """(N,) of the photos: files below the folder of photos where the format names them."""


@dataclass(frozen=True)
class Calibration:
    """How one camera maps directions to pixels, in the words of OpenCV and ROS."""

    camera: str
    """Name of its photo."""
    width: int
    height: int
    K: F64
    """(3, 3) pixels, the middle of the first pixel at (0, 0); all zero where it has none."""
    distortion_model: str
    """``plumb_bob``, ``rational_polynomial`` or ``kannala_brandt``; else COLMAP's name of it."""
    D: tuple[float, ...]
    """Parameters of that model, in its order."""


@dataclass(frozen=True)
class Trajectory(Poses):
    """Where a lidar was at each of its sweeps, local frame."""

    times_ns: I64
    """(N,) of the sweeps, since the epoch of the log."""


@dataclass(frozen=True)
class InstancePoses(Poses):
    """Base centres and rotations of the accepted instances, world, for viewers."""
