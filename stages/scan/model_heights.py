"""Which points of a scene may be on the top of an object that stands on something."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F32, Mask
from spinpipe.schemas.records import ObjectModel, Sampling
from spinpipe.stages.geometry.support import (
    BASE_SLACK,
    find_surfaces,
    has_support,
    reach_of,
    support_halo_m,
)


@dataclass(frozen=True)
class HeightBands:
    """Heights above what they stand on at which the origins of models lie."""

    bands: tuple[tuple[float, float], ...]
    """Lowest and highest of each model, metres."""
    reach_m: float
    gap_m: float
    """Height without points above which another surface begins."""
    sampling: Sampling

    @classmethod
    def of(
        cls, models: Sequence[ObjectModel], heights_m: Sequence[float], sampling: Sampling
    ) -> HeightBands:
        """Bands around the origins of models, widened by their stretch, by slack and by the noise.

        Parameters
        ----------
        models : that are looked for.
        heights_m : of the point of each at which its spin image is taken, above its base.
        sampling : of the cloud.
        """
        sizes = [model.size for model in models]
        bands: list[tuple[float, float]] = []
        for model, height_m in zip(models, heights_m, strict=True):
            slack = BASE_SLACK * height_m + 3.0 * sampling.noise_m
            low = height_m * (1.0 - model.stretch) - slack
            bands.append((low, height_m * (1.0 + model.stretch) + slack))
        stretched = (
            float(np.hypot(size[0], size[1])) / 2 * (1.0 + model.stretch)
            for model, size in zip(models, sizes, strict=True)
        )
        gap_m = 0.5 * min(float(size[2]) for size in sizes)
        return cls(tuple(bands), reach_of(max(stretched)), gap_m, sampling)

    @property
    def halo_m(self) -> float:
        """How far around a point its surroundings must be known."""
        return support_halo_m(self.sampling, self.reach_m)

    def select(self, points: F32) -> Mask:
        """(N,) which of (N, 3) points lie in a band; right for those ``halo_m`` from the border."""
        if len(points) == 0:
            return np.zeros(0, bool)
        xyz = points.astype(np.float64)
        surfaces = find_surfaces(xyz, self.sampling, self.reach_m, self.gap_m)
        return has_support(xyz, surfaces, np.array(self.bands))
