"""Which points of a scene may be the topmost point of an object that stands on the ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F32, Mask
from spinpipe.schemas.records import ObjectModel, Sampling
from spinpipe.stages.geometry.local_ground import ground_halo_m, local_ground

GROUND_REACH_HALF_DIAGONALS = 1.4
"""Radius within which an object's ground is looked for, in half diagonals of its footprint."""
BASE_SLACK_SHARE = 0.15
"""How far the base may be off the local ground, as a share of the object's height."""


@dataclass(frozen=True)
class HeightBands:
    """Heights above the local ground at which the tops of models lie."""

    bands: tuple[tuple[float, float], ...]
    """Lowest and highest of each model, metres."""
    reach_m: float
    sampling: Sampling

    @classmethod
    def of(cls, models: Sequence[ObjectModel], sampling: Sampling) -> HeightBands:
        """Bands of models, widened by their stretch, by slack and by the noise."""
        sizes = [model.size for model in models]
        bands: list[tuple[float, float]] = []
        for model, size in zip(models, sizes, strict=True):
            slack = max(BASE_SLACK_SHARE * float(size[2]), 3.0 * sampling.noise_m)
            low = float(size[2]) * (1.0 - model.stretch) - slack
            bands.append((low, float(size[2]) * (1.0 + model.stretch) + slack))
        stretched = (
            float(np.hypot(size[0], size[1])) / 2 * (1.0 + model.stretch)
            for model, size in zip(models, sizes, strict=True)
        )
        return cls(tuple(bands), GROUND_REACH_HALF_DIAGONALS * max(stretched), sampling)

    @property
    def halo_m(self) -> float:
        """How far around a point its surroundings must be known."""
        return ground_halo_m(self.sampling, self.reach_m)

    def select(self, points: F32) -> Mask:
        """(N,) which of (N, 3) points lie in a band; right for those ``halo_m`` from the border."""
        if len(points) == 0:
            return np.zeros(0, bool)
        ground = local_ground(points.astype(np.float64), self.sampling, self.reach_m)
        height = points[:, 2] - ground
        inside = [(height >= low) & (height <= high) for low, high in self.bands]
        return np.any(inside, axis=0)
