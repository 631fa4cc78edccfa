"""Points of the cloud around a tile or a place, read tile by tile from the ingest file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F32, F64, Mask
from spinpipe.schemas.records import CloudTile, TileIndex, Upright
from spinpipe.stages.geometry.frames import to_world, transform


@dataclass(frozen=True)
class WorldCloud:
    """The cloud in the world frame, without holding it: tiles are read when they are needed."""

    tiles: Sequence[CloudTile]
    upright: Upright
    low: F64
    """(T, 3) least corner of each tile's box in the world."""
    high: F64
    """(T, 3) greatest corner."""
    counts: tuple[int, ...]

    @classmethod
    def of(cls, tiles: Sequence[CloudTile], index: TileIndex, upright: Upright) -> WorldCloud:
        """The cloud of a run; boxes of tiles are those of their turned corners."""
        sides = np.stack([index.low, index.high]).astype(np.float64)  # (2, T, 3)
        picks = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8)
        corners = np.stack([sides[pick, :, axis] for axis, pick in enumerate(picks)], axis=-1)
        world = transform(upright.T_world_local, corners.reshape(-1, 3)).reshape(8, -1, 3)
        slack = 1e-5 * (1.0 + np.abs(world).max(initial=0.0))  # float32 rounding of the points
        return cls(
            tiles=tiles,
            upright=upright,
            low=world.min(axis=0) - slack,
            high=world.max(axis=0) + slack,
            counts=tuple(int(n) for n in index.counts),
        )

    def __len__(self) -> int:
        """Number of tiles."""
        return len(self.counts)

    def points(self, tile: int) -> F32:
        """(N, 3) points of one tile, world."""
        return to_world(self.upright, self.tiles[tile].xyz)

    def inside(self, low: F64, high: F64) -> F32:
        """(N, 3) points of all tiles within a closed box, world; in the order of the tiles."""
        return np.concatenate([np.empty((0, 3), np.float32), *self._cuts(low, high).values()])

    def around(
        self, tile: int, radius_m: float, below_m: float, above_m: float = 0.0
    ) -> tuple[F32, Mask]:
        """Points of one tile and of its surroundings: sideways, below and above, world.

        Returns
        -------
        points : (N, 3) float32
        own : (N,) which of them are the tile's own; all its points are there, in their order.
        """
        below = np.array([radius_m, radius_m, below_m])
        above = np.array([radius_m, radius_m, above_m])
        cuts = self._cuts(self.low[tile] - below, self.high[tile] + above)
        own = [np.full(len(xyz), number == tile) for number, xyz in cuts.items()]
        return np.concatenate(list(cuts.values())), np.concatenate(own)

    def _cuts(self, low: F64, high: F64) -> dict[int, F32]:
        """What lies within a closed box, by tile."""
        cuts: dict[int, F32] = {}
        for tile in np.flatnonzero(np.all((self.low <= high) & (self.high >= low), axis=1)):
            xyz = self.points(int(tile))
            cuts[int(tile)] = xyz[np.all((xyz >= low) & (xyz <= high), axis=1)]
        return cuts
