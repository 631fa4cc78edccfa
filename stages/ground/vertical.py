"""The vertical of a scene: the direction in which level and upright surfaces agree.

What people build is level or upright, more often than not; ramps, slopes and roofs are neither,
or lean each its own way. So every surface is a witness, for its own normal and for whatever is
perpendicular to it, and the vertical is the direction of the greatest likelihood. Each counts by
the root of its area, so that many levels and walls outvote one large ramp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.ground.surfaces import Surfaces

WITNESSES = 128
"""Largest surfaces that are heard; smaller ones are details."""
EXACT = np.radians(0.5)
"""Deviation of level surfaces from level and of walls from upright, as far as it is common:
chosen; between 0.3 and 1.0 up changes by 0.1 degrees or less on all scenes of the benchmark."""
LEVEL_SHARE, UPRIGHT_SHARE = 0.5, 0.3
"""Share of the surfaces that is level, and upright: chosen for yards, streets and rooms."""
DIRECTIONS = 4000
"""Directions of the half sphere that are tried: 2.3 degrees apart."""
APART_DEG = 20.0
"""Verticals that differ by less are one hypothesis, whose best direction counts."""
LEAST_SUPPORT = 1.0
"""Support of a vertical; points scattered through a volume reach 0.3, the least of the tested
scenes 3."""
CANDIDATES = 6
"""Verticals that are looked at further."""
CONVENTIONS = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
"""Axes that files call up. Their opposites are cameras' axes, which are only near the vertical."""
CONVENTION_LOSS = 2.0
"""Loss of support at which an axis of the file is still the vertical: it is so exactly in most
files and by chance in one of several thousand, so the surfaces' word must be clear against it."""
CONVENTION_DEG = 5.0
"""And the angle: as much as ground slopes that is taken for level."""
FINEST_DEG = 0.01
"""Step at which the search for the best direction ends."""


@dataclass(frozen=True)
class Vertical:
    """An axis that may be the vertical."""

    axis: F64
    """(3,) unit vector of either sign."""
    support: float
    """Log likelihood of the surfaces, each weighted by the root of its share of the scene."""
    convention: F64 | None = None
    """(3,) the file's +z or +y where the surfaces have nothing against its being up exactly."""


@dataclass(frozen=True)
class Witnesses:
    """Surfaces that testify where the vertical is."""

    surfaces: Surfaces

    @classmethod
    def of(cls, surfaces: Surfaces) -> Witnesses:
        """The largest of all surfaces."""
        return cls(surfaces.at(np.arange(min(WITNESSES, len(surfaces)))))

    def support(self, axes: F64) -> F64:
        """Log likelihood (A,) of axes (A, 3), relative to surfaces that lie at random.

        A normal deviates from the axis, or from perpendicular to it, by an angle with heavy
        tails (Cauchy's distribution in two dimensions, or in one) as wide as ``EXACT`` and the
        normal's own error together.
        """
        cosine = np.minimum(np.abs(axes @ self.surfaces.normal.T), 1.0)
        variance = EXACT**2 + self.surfaces.error**2
        level = np.sqrt(variance) / (2 * (1 - cosine) + variance) ** 1.5
        upright = np.sqrt(variance) / (np.pi * (cosine**2 + variance))
        chance = 1 - LEVEL_SHARE - UPRIGHT_SHARE
        likelihood = chance + LEVEL_SHARE * level + UPRIGHT_SHARE * upright
        return np.log(likelihood) @ np.sqrt(self.surfaces.share)

    def verticals(self, also: F64) -> list[Vertical]:
        """The axes with the most support, best first, at least ``APART_DEG`` from each other.

        Parameters
        ----------
        also
            (M, 3) unit vectors to try beside the half sphere's and the surfaces' normals.
        """
        tried = np.concatenate([half_sphere(DIRECTIONS), self.surfaces.normal, also])
        support = self.support(tried)
        apart = np.cos(np.radians(APART_DEG))
        found: list[Vertical] = []
        while len(found) < CANDIDATES and np.isfinite(support).any():
            start = tried[np.argmax(support)]
            axis = self.best_near(start)
            if all(abs(axis @ other.axis) <= apart for other in found):
                found.append(self._vertical(axis))
            support[np.abs(tried @ np.stack([start, axis], axis=1)).max(axis=1) > apart] = -np.inf
        return sorted(found, key=lambda vertical: -vertical.support)

    def _vertical(self, axis: F64) -> Vertical:
        support = float(self.support(axis[None])[0])
        near = np.abs(CONVENTIONS @ axis) > np.cos(np.radians(CONVENTION_DEG))
        kept = near & (support - self.support(CONVENTIONS) <= CONVENTION_LOSS)
        return Vertical(axis, support, CONVENTIONS[np.argmax(kept)] if kept.any() else None)

    def best_near(self, axis: F64) -> F64:
        """Climb from an axis to the direction of the greatest support, by pattern search."""
        support, step_deg = self.support(axis[None])[0], 2.0
        turns = np.arange(12) * np.pi / 6
        while step_deg > FINEST_DEG:
            across = np.linalg.svd(axis[None])[2][1:]
            steps = np.stack([np.cos(turns), np.sin(turns)], axis=1) @ across
            around = axis + np.radians(step_deg) * steps
            around /= np.linalg.norm(around, axis=1, keepdims=True)
            found = self.support(around)
            best = int(np.argmax(found))
            if found[best] > support:
                axis, support = around[best], found[best]
            else:
                step_deg /= 2
        return axis


def half_sphere(count: int) -> F64:
    """Unit vectors (count, 3), evenly spread: the spherical Fibonacci lattice [Gonzalez 2010]."""
    rank = np.arange(count) + 0.5
    z = 1 - rank / count
    turn = np.pi * (1 + np.sqrt(5.0)) * rank
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
