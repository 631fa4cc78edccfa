"""Flat patches of a point sample: the largest cells of an octree that are flat as a whole.

Merging cells while the union is no thicker than its parts [Limberger & Oliveira 2015, section 3,
who split instead] takes no tolerance from outside: what counts as flat follows from the noise of
the smallest cells that are wide against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F64, I64, Mask

LEVELS = 12
"""Doublings of the cells: from the sample's spacing to the whole scene."""
SPAN = 2048
"""Smallest cells are no smaller than this part of the extent; two thousand are a fine raster."""
LEAST_POINTS = 6
"""Points of a cell that has a plane: twice as many as define one."""
FILLED = 8
"""Points that half of the sample has to share its cell with before cells are large enough."""
NARROW = 0.05
"""A cell's second variance relative to its first: scan lines and edges are no surfaces."""
WELL_KNOWN = np.radians(2.0)
NORMAL_ERROR = np.radians(4.0)
"""Standard errors of a cell's normal: of the best tenth before cells are large enough, of any."""
BEST = 0.1
"""Share of a scene that is smooth whatever it shows."""
THICKER = 2.0
"""Variance of a flat union relative to that of its parts, noise and waviness included."""
WHOLE = 0.9
"""Share of a flat cell's points that do not lie in rough parts."""


FLATTEST = 0.5
"""A smallest cell's thickness relative to its width; beyond it is a heap, not a surface."""
FLOAT32_NOISE = 1e-4
"""Thickness of planes without noise relative to their width, from coordinates in float32."""
AXES = tuple((i, j) for i in range(3) for j in range(i, 3))


@dataclass(frozen=True)
class _Moments:
    """Sums over the points of each cell."""

    cell: I64
    """(C, 3)."""
    count: F64
    first: F64
    """(C, 3)."""
    second: F64
    """(C, 6): xx, xy, xz, yy, yz, zz."""

    def doubled(self) -> tuple[_Moments, I64]:
        """Cells of twice the edge, and the row of each cell's parent."""
        parent = self.cell >> 1
        size = parent.max(axis=0) + 1
        key = (parent[:, 0] * size[1] + parent[:, 1]) * size[2] + parent[:, 2]
        _, first, row = np.unique(key, return_index=True, return_inverse=True)
        rows = len(first)

        def sums(values: F64) -> F64:
            columns = [np.bincount(row, column, rows) for column in values.T]
            return np.stack(columns, axis=1).astype(np.float64)

        count = np.bincount(row, self.count, rows).astype(np.float64)
        return _Moments(parent[first], count, sums(self.first), sums(self.second)), row


@dataclass(frozen=True)
class Patches:
    """Flat pieces of the scene, without overlap."""

    centre: F64
    """(P, 3)."""
    normal: F64
    """(P, 3) unit, of either sign."""
    points: F64
    """(P,) points of the sample: the area, as the sample is uniform."""
    thickness: F64
    """(P,) standard deviation along the normal."""
    width: F64
    """(P,) standard deviation along the narrower of the other axes."""
    error: F64
    """(P,) standard error of the normal, radians [Anderson 1963, theorem 1]."""


def flat_patches(points: F64, voxel: float) -> Patches:
    """Find the largest flat cells.

    Parameters
    ----------
    points
        (N, 3) sample, uniform in area.
    voxel
        Its spacing.
    """
    low, high = np.quantile(points, (0.02, 0.98), axis=0)
    edge = max(voxel, float((high - low).max()) / SPAN, np.finfo(float).tiny)
    middle = np.median(points, axis=0)  # keeps the sums of squares small
    points = points - middle
    cell = np.floor(points / edge).astype(np.int64)
    squares = np.stack([points[:, i] * points[:, j] for i, j in AXES], axis=1)
    moments = _Moments(cell - cell.min(axis=0), np.ones(len(points)), points, squares)
    levels: list[_Level] = []
    for _ in range(LEVELS):
        moments, parent = moments.doubled()
        if levels and levels[0].fine:
            levels.append(_merged(moments, parent, levels[-1]))
        else:
            levels = [_smallest(moments, parent)]
    kept: list[tuple[F64, ...]] = []
    for level, above in zip(levels, [*levels[1:], None], strict=True):
        largest = level.flat if above is None else level.flat & ~above.flat[above.parent]
        kept.append(tuple(column[largest] for column in level.columns))
    centre, *others = (np.concatenate(column) for column in zip(*kept, strict=True))
    return Patches(centre + middle, *others)


@dataclass(frozen=True)
class _Level:
    """The cells of one size."""

    parent: I64
    """Row in this level of each cell of the level below."""
    columns: tuple[F64, ...]
    """As in ``Patches``, for every cell."""
    flat: Mask
    rough: Mask
    """Cells that have a shape, and not a flat one; the others have too few points to tell."""
    noise: F64
    """(C,) variance across the surface, within the smallest flat parts."""
    fine: bool = True
    """Whether cells are as large as it takes to know normals."""


def _components(moments: _Moments) -> tuple[tuple[F64, ...], Mask]:
    """Columns of ``Patches`` for each cell, and which cells spread in two directions."""
    count, centre = moments.count, moments.first / moments.count[:, None]
    covariance = np.empty((len(count), 3, 3))
    for (i, j), squares in zip(AXES, moments.second.T, strict=True):
        covariance[:, i, j] = squares / count - centre[:, i] * centre[:, j]
        covariance[:, j, i] = covariance[:, i, j]
    values, vectors = np.linalg.eigh(covariance)
    values = np.maximum(values, 0)
    thickness, width = np.sqrt(values[:, 0]), np.sqrt(values[:, 1])
    error = thickness / np.maximum(width * np.sqrt(count), np.finfo(float).tiny)
    wide = (count >= LEAST_POINTS) & (values[:, 1] > NARROW * values[:, 2])
    return (centre, vectors[:, :, 0], count, thickness, width, error), wide


def _smallest(moments: _Moments, parent: I64) -> _Level:
    """The first level, if its normals are known well enough; flat where they are."""
    columns, wide = _components(moments)
    _, _, count, thickness, width, error = columns
    order = np.argsort(np.where(wide, error, np.inf))
    best = order[np.searchsorted(np.cumsum(count[order]), BEST * count.sum())]
    filled = count[count >= FILLED].sum() >= count.sum() / 2
    fine = bool(filled and wide[best] and error[best] <= WELL_KNOWN)
    flat = wide & (error < NORMAL_ERROR) & (thickness < FLATTEST * width)
    return _Level(parent, columns, flat, wide & ~flat, thickness**2, fine)


def _merged(moments: _Moments, parent: I64, below: _Level) -> _Level:
    """The level above: flat where the parts are and the union is no thicker."""
    columns, wide = _components(moments)
    _, _, count, thickness, _, _ = columns
    flat_points = below.columns[2] * below.flat
    held = np.bincount(parent, flat_points, len(count))
    noise = np.bincount(parent, flat_points * below.noise, len(count)) / np.maximum(held, 1)
    rough = np.bincount(parent, below.columns[2] * below.rough, len(count))
    whole = (held >= count / 2) & (rough <= (1 - WHOLE) * count)
    exact = (FLOAT32_NOISE * columns[4]) ** 2  # planes without noise
    flat = wide & whole & (thickness**2 <= THICKER * noise + exact)
    return _Level(parent, columns, flat, wide & ~flat, noise)
