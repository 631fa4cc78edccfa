"""Which axis is the vertical, which of its ends is up, and the rotation that follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.ground.evidence import (
    SLOPE_DEG,
    Surface,
    Terrain,
    camera_evidence,
    distinct_terrains,
    scene_evidence,
)
from spinpipe.stages.ground.patches import FLOAT32_NOISE
from spinpipe.stages.ground.plane import FittedPlane
from spinpipe.stages.ground.surfaces import SIGMAS, Surfaces
from spinpipe.stages.ground.vertical import LEAST_SUPPORT, Vertical

CERTAIN = 0.95
"""No single piece of evidence rules a hypothesis out."""
SAME_DIRECTION_DEG = 20.0
"""Hypotheses whose ups differ by less do not contradict each other."""
NEGLIGIBLE = 6.0
"""A vertical with so much less support than the best one is not looked at."""
SUPPORT_SCALE = 2.0
"""Loss of support that divides a hypothesis's score by e: surfaces are not independent."""
CONVENTIONAL = 0.3
"""Evidence of the file's z for its positive end: cannot decide alone, breaks what is close."""
PLANES, NOTABLE = 3, 0.3
"""Level surfaces tried as a vertical's ground, and their least area relative to the largest."""


@dataclass(frozen=True)
class Hypothesis:
    """An axis taken as the vertical, one of its ends as up, and a surface as the ground.

    Every piece of evidence in -1..1 must hold, so the score is the product of
    ``(1 + evidence) / 2``, times the root of the relative area of the ground, times the
    (tempered) likelihood of the vertical.
    """

    vertical: Vertical
    terrain: Terrain
    area: float
    """Of its largest connected piece, relative to that of the largest ground."""
    likelihood: float
    """Of the vertical, relative to that of the best one."""
    evidence: dict[str, float]

    @property
    def up(self) -> F64:
        """(3,) unit vector: the file's own axis where it may be that."""
        named = self.vertical.convention
        return named if named is not None and named @ self.terrain.up > 0 else self.terrain.up

    @property
    def score(self) -> float:
        """In 0..1, larger is better."""
        return float(np.sqrt(self.area)) * self.likelihood * self.weight()

    def weight(self, source: str = "") -> float:
        """Product of the evidence whose name starts with ``source``."""
        votes = [v for name, v in self.evidence.items() if name.startswith(source)]
        return float(np.prod([(1 + np.clip(v, -CERTAIN, CERTAIN)) / 2 for v in votes]))


def rank(
    surface: Surface,
    surfaces: Surfaces,
    verticals: list[Vertical],
    cameras: tuple[F64, F64] | None,
) -> list[Hypothesis]:
    """Try every vertical with either end up and its largest level surfaces as the ground.

    Parameters
    ----------
    surface
        The scene.
    surfaces
        Its planes.
    verticals
        What may be the vertical, the best first.
    cameras
        Positions (C, 3) and rotations (C, 3, 3) of the cameras, in the frame of the points.

    Returns
    -------
    list of Hypothesis
        Best first.
    """
    tried: list[tuple[Vertical, Terrain]] = []
    for vertical in verticals:
        if vertical.support >= max(verticals[0].support - NEGLIGIBLE, LEAST_SUPPORT):
            planes = _level_planes(surfaces, vertical.axis, FLOAT32_NOISE * surface.voxel)
            terrains = distinct_terrains(surface, vertical.axis, planes)
            tried += [(vertical, terrain) for terrain in terrains]
    if not tried:
        return []
    axes, terrains = zip(*tried, strict=True)
    areas = [_largest_piece(surface, terrain) for terrain in terrains]
    hypotheses: list[Hypothesis] = []
    for signed in (terrains, tuple(terrain.flipped() for terrain in terrains)):
        found = scene_evidence(surface, signed)
        for vertical, terrain, area, evidence in zip(axes, signed, areas, found, strict=True):
            loss = 0.0 if vertical is verticals[0] else verticals[0].support - vertical.support
            likelihood = float(np.exp(-loss / SUPPORT_SCALE))
            if vertical.convention is not None and vertical.convention[2] == 1:
                evidence["file's z"] = CONVENTIONAL * float(np.sign(terrain.up[2]))
            if cameras is not None:
                evidence |= camera_evidence(*cameras, terrain.level(surface.points))
            share = area / max(areas)
            hypotheses.append(Hypothesis(vertical, terrain, share, likelihood, evidence))
    return sorted(hypotheses, key=lambda h: -h.score)


def _level_planes(surfaces: Surfaces, axis: F64, least: float) -> list[FittedPlane]:
    """The largest surfaces that slope no more than ground does."""
    cosine = surfaces.normal @ axis
    level = np.flatnonzero(np.abs(cosine) > np.cos(np.radians(SLOPE_DEG)))
    level = level[surfaces.share[level] >= NOTABLE * surfaces.share[level].max(initial=0)][:PLANES]
    planes: list[FittedPlane] = []
    for row in level:
        normal = surfaces.normal[row] * np.copysign(1.0, cosine[row])
        offset = -float(normal @ surfaces.centre[row])
        distance = SIGMAS * max(float(surfaces.thickness[row]), least)
        planes.append(FittedPlane(normal, offset, distance))
    return planes


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
