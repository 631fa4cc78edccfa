"""The scan of one tile of the cloud: which of its points are origins, and how they correlate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.colormap import viridis
from spinpipe.schemas.records import F32, ScoreTile
from spinpipe.stages.model_heights import HeightBands
from spinpipe.stages.neighbourhood import WorldCloud
from spinpipe.stages.spin_image import SpinTemplate
from spinpipe.stages.spin_index import build_index
from spinpipe.stages.spin_kernel import BELOW, correlate
from spinpipe.stages.spin_voxel import correlate_near_promising
from spinpipe.stages.voxels import voxel_representatives

Origins = Literal["all", "voxel", "subset"]


@dataclass(frozen=True)
class TileScan:
    """What it takes to scan any tile of a cloud; can be sent to a worker."""

    cloud: WorldCloud
    models: tuple[str, ...]
    templates: tuple[SpinTemplate, ...]
    """One a model, all of one grid."""
    bands: HeightBands | None
    """None: origins at any height."""
    origins: Origins
    min_correlation: float
    exhaustive: bool
    """Whether origins that are no hits are scored too."""
    threads: int

    def __call__(self, tile: int) -> ScoreTile:
        """Origins of a tile with their correlations; without ``exhaustive`` only the hits.

        Reads as much around the tile as any of its results depends on, so the result for an
        origin does not depend on where the tile ends.
        """
        grid = self.templates[0].grid
        reach_m = np.sqrt(3.0) * grid.bin_m
        margin_m = 0.0 if self.origins == "all" else reach_m + grid.bin_m
        if self.bands:
            around, own = self.cloud.around(
                tile, max(grid.radius_m, self.bands.halo_m) + margin_m, np.inf, margin_m
            )
            eligible = self.bands.select(around)
        else:
            around, own = self.cloud.around(
                tile, grid.radius_m + margin_m, grid.height_m + margin_m, margin_m
            )
            eligible = np.ones(len(around), bool)
        origins = around[own & eligible]
        index = build_index(around)
        if self.origins == "voxel":
            near = np.all(
                (around >= self.cloud.low[tile] - reach_m)
                & (around <= self.cloud.high[tile] + reach_m),
                axis=1,
            )
            correlation = correlate_near_promising(
                index,
                origins,
                _one_in_each_voxel(around[near & eligible], around[eligible], grid.bin_m),
                self.templates,
                self.threads,
                min_correlation=self.min_correlation,
                reach_m=float(reach_m),
            )
        else:
            if self.origins == "subset":
                origins = _one_in_each_voxel(origins, around[eligible], grid.bin_m)
            correlation = correlate(
                index,
                origins,
                self.templates,
                self.threads,
                min_correlation=None if self.exhaustive else self.min_correlation,
            )
        return self._scores(origins, correlation.T)

    def _scores(self, origins: F32, correlation: NDArray[np.float32]) -> ScoreTile:
        best = correlation.max(axis=1, initial=BELOW)
        kept = best > BELOW
        return ScoreTile(
            self.models,
            origins[kept],
            np.ascontiguousarray(correlation[kept]),
            viridis(best[kept]),
        )


def _one_in_each_voxel(points: F32, around: F32, side_m: float) -> F32:
    return points[voxel_representatives(points, around, side_m)]
