"""Candidates that lie close together, and what each of them stands on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F64, I64, Mask
from spinpipe.schemas.records import Sampling
from spinpipe.stages.geometry.support import find_support, find_surfaces
from spinpipe.stages.verify.judge.hypotheses import Place
from spinpipe.stages.verify.scene.cell_grid import CellGrid, grid_of


@dataclass(frozen=True, eq=False)
class Block:
    """Candidates that are examined together: the points around, and where each stands."""

    grid: CellGrid
    places: tuple[Place, ...]
    found: Mask
    """(C,) whether there is a surface for it to stand on."""

    @classmethod
    def of(
        cls,
        points: NDArray[np.floating],
        places: F64,
        height_m: F64,
        slack_m: F64,
        sampling: Sampling,
        reach_m: float,
        gap_m: float,
    ) -> Block:
        """Find what candidates stand on.

        Parameters
        ----------
        points : (N, 3) world, around all of them.
        places : (C, 3) world, the candidates.
        height_m, slack_m : (C,) how high above its support each should be, and how exactly.
        sampling : of the cloud.
        reach_m : how far around a place its support may be seen.
        gap_m : height without points above which another surface begins.
        """
        xyz = np.asarray(points, np.float64)
        surfaces = find_surfaces(xyz, sampling, reach_m, gap_m)
        support = find_support(places, places[:, 2] - height_m, surfaces, slack_m)
        origin = np.column_stack([places[:, :2], support.height])
        lean = np.column_stack([support.slope_x, support.slope_y])
        tops = places[:, 2] - origin[:, 2]
        stands = tuple(Place(*p) for p in zip(origin, lean, tops.tolist(), strict=True))
        return cls(grid_of(xyz, sampling), stands, support.found > 0)


def first_around(places: F64, reach_m: F64) -> Mask:
    """Whether each place (N, 3) has none before it within its reach (N,)."""
    apart = np.linalg.norm(places[:, None, :2] - places[None, :, :2], axis=2)
    return ~np.tril(apart < reach_m[:, None], -1).any(axis=1)


def blocks(places: F64, block_m: float) -> Iterator[I64]:
    """Rows of the candidates of each occupied square, squares in order."""
    square = np.floor(places[:, :2] / block_m).astype(np.int64)
    _, number = np.unique(square, axis=0, return_inverse=True)
    number = number.ravel()
    for k in range(int(number.max(initial=-1)) + 1):
        yield np.flatnonzero(number == k)
