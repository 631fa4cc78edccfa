"""Which plane is the ground, which of its sides is up, and the rotation that follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.ground.evidence import (
    Surface,
    Terrain,
    camera_evidence,
    distinct_terrains,
    scene_evidence,
)
from spinpipe.stages.ground.plane import FittedPlane

F64 = NDArray[np.float64]

CERTAIN = 0.95
"""No single piece of evidence rules a hypothesis out."""
SAME_DIRECTION_DEG = 20.0
"""Hypotheses whose ups differ by less do not contradict each other."""


@dataclass(frozen=True)
class Hypothesis:
    """A plane taken as the ground, its normal as up.

    Every piece of evidence in -1..1 must hold, so the score is the product of
    ``(1 + evidence) / 2``, times the root of the relative area of the ground.
    """

    terrain: Terrain
    area: float
    """Of its largest connected piece, relative to that of the largest ground."""
    evidence: dict[str, float]

    @property
    def up(self) -> F64:
        """(3,) unit vector."""
        return self.terrain.plane.normal

    @property
    def score(self) -> float:
        """In 0..1, larger is better."""
        return float(np.sqrt(self.area)) * self.weight()

    def weight(self, source: str = "") -> float:
        """Product of the evidence whose name starts with ``source``."""
        votes = [v for name, v in self.evidence.items() if name.startswith(source)]
        return float(np.prod([(1 + np.clip(v, -CERTAIN, CERTAIN)) / 2 for v in votes]))


def rank(
    surface: Surface, planes: list[FittedPlane], cameras: tuple[F64, F64] | None
) -> list[Hypothesis]:
    """Try every plane with either side up, best first.

    Parameters
    ----------
    surface
        The scene.
    planes
        Its planes.
    cameras
        Positions (C, 3) and rotations (C, 3, 3) of the cameras, in the frame of the points.
    """
    hypotheses: list[Hypothesis] = []
    terrains = distinct_terrains(surface, planes)
    areas = [_largest_piece(surface, terrain) for terrain in terrains]
    for signed in (terrains, [terrain.flipped() for terrain in terrains]):
        found = scene_evidence(surface, signed)
        for terrain, area, evidence in zip(signed, areas, found, strict=True):
            if cameras is not None:
                evidence |= camera_evidence(*cameras, terrain.plane)
            hypotheses.append(Hypothesis(terrain, area / max(areas), evidence))
    return sorted(hypotheses, key=lambda h: -h.score)


def _largest_piece(surface: Surface, terrain: Terrain) -> int:
    """Points of the ground that hang together: tops of many things are islands, ground is not."""
    return int(np.bincount(surface.groups(terrain.members), minlength=1).max())


def best_rival(hypotheses: list[Hypothesis]) -> Hypothesis:
    """Find the best hypothesis whose up contradicts that of the first one."""
    limit = np.cos(np.radians(SAME_DIRECTION_DEG))
    return next(h for h in hypotheses if h.up @ hypotheses[0].up < limit)


def up_quaternion(up: F64) -> tuple[float, float, float, float]:
    """Find the smallest rotation from ``up`` to +z, as a unit quaternion (x, y, z, w).

    The half-angle form of the rotation in the plane of the two vectors; straight down, where
    every horizontal axis serves, it is half a turn about +x.

    Parameters
    ----------
    up
        (3,), not zero.
    """
    x, y, z = up / np.linalg.norm(up)
    # 1 + z without cancellation near -1.
    one_plus_z = (x * x + y * y) / (1 - z) if z < 0 else 1 + z
    w = np.sqrt(one_plus_z / 2)
    if w == 0:
        return (1.0, 0.0, 0.0, 0.0)
    q = np.array([y / (2 * w), -x / (2 * w), 0.0, w])
    q /= np.linalg.norm(q)
    return (float(q[0]), float(q[1]), float(q[2]), float(q[3]))
