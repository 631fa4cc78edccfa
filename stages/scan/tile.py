"""The scan of one tile of the cloud: which of its points are origins, and how they correlate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from spinpipe.schemas.arrays import F32, Mask
from spinpipe.schemas.colormap import viridis
from spinpipe.schemas.records import ScoreTile
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.scan.coarse_to_fine import correlate_coarse_to_fine, halo_m
from spinpipe.stages.scan.correlate import BELOW, correlate
from spinpipe.stages.scan.index import build_index
from spinpipe.stages.scan.model_heights import HeightBands
from spinpipe.stages.scan.templates import Templates
from spinpipe.stages.scan.voxels import Voxels

Origins = Literal["all", "voxel", "subset"]


@dataclass(frozen=True)
class TileScan:
    """What it takes to scan any tile of a cloud; can be sent to a worker."""

    cloud: WorldCloud
    models: tuple[str, ...]
    templates: Templates
    """One a model."""
    bands: HeightBands | None
    """None: origins at any height."""
    lift_m: float
    """How far above its point an origin is taken."""
    origins: Origins
    min_correlation: float
    voxel_m: float
    """Side of a voxel, unless ``origins`` is "all"."""
    pruned: bool
    """Whether only hits are scored."""
    threads: int

    def __call__(self, tile: int) -> ScoreTile:
        """Origins of a tile with their correlations; those left out of the scan are missing.

        Reads as much around the tile as any of its results depends on, so the result for an
        origin does not depend on where the tile ends.
        """
        around, own, eligible = self._surroundings(tile)
        index = build_index(around)
        points, own = around[eligible], own[eligible]
        origins = points + np.array([0, 0, self.lift_m], np.float32)
        if self.origins == "voxel":
            correlation = correlate_coarse_to_fine(
                index,
                origins,
                own,
                self.templates,
                self.threads,
                min_correlation=self.min_correlation,
                voxel_m=self.voxel_m,
                pruned=self.pruned,
            )
        else:
            if self.origins == "subset":
                own &= Voxels.of(points, self.voxel_m).represents()
            correlation = correlate(
                index,
                origins[own],
                self.templates,
                self.threads,
                min_correlation=self.min_correlation if self.pruned else None,
            )
        return self._scores(points[own], correlation.T)

    def _surroundings(self, tile: int) -> tuple[F32, Mask, Mask]:
        """Points that the tile's origins may see; which are its own; which may be origins."""
        grid = self.templates.grid
        margin_m = 0.0 if self.origins == "all" else halo_m(self.voxel_m)
        above_m = self.lift_m + margin_m
        if self.bands:
            reach_m = max(grid.radius_m, self.bands.halo_m) + margin_m
            around, own = self.cloud.around(tile, reach_m, np.inf, above_m)
            eligible = self.bands.select(around)
        else:
            below_m = grid.height_m + margin_m
            around, own = self.cloud.around(tile, grid.radius_m + margin_m, below_m, above_m)
            eligible = np.ones(len(around), bool)
        if self.origins == "all":
            return around, own, eligible & own
        low, high = self.cloud.low[tile] - margin_m, self.cloud.high[tile] + margin_m
        return around, own, eligible & np.all((around >= low) & (around <= high), axis=1)

    def _scores(self, origins: F32, correlation: F32) -> ScoreTile:
        best = correlation.max(axis=1, initial=BELOW)
        kept = best > BELOW
        return ScoreTile(
            self.models,
            origins[kept],
            np.ascontiguousarray(correlation[kept]),
            viridis(best[kept]),
        )
