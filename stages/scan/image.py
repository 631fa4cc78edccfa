"""Spin images about the vertical, their correlation, and the plain numpy twin of the kernels.

A spin image counts the points around an origin by their distance from the vertical axis through
it and by their depth below it. It needs no normals and does not change when the object turns
about the vertical [Johnson & Hebert 1999; Bovenkamp 2010, section 2.1].

Everything here is float32 up to the counts, so that the compiled kernels can give the very same
integers; see ``SpinGrid`` for the exact rule.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import U32
from spinpipe.stages.scan.count import FLAT_VARIANCE

MAX_BINS = 60_000
"""Most bins of one grid: the kernels hold bin numbers in 16 bits."""


class SpinGrid(NamedTuple):
    """Extent and bins of a spin image [Bovenkamp 2010, section 2.1]; made by ``SpinGrid.of``.

    A point at horizontal distance ``a`` from the origin and depth ``b`` below it is counted when
    ``a < radius_m`` and ``0 < b < height_m``, in row ``floor(b / bin_m)`` and column
    ``floor(a / bin_m)``. In float32: ``a2 = dx * dx + dy * dy`` is compared with ``radius_sq``
    (the same as ``sqrt(a2) < radius_m``); the column is ``int(sqrt(a2) * bins_per_m)``, the row
    ``int(b * bins_per_m)``.

    The number of rows and columns is the quotient rounded up, where a quotient within a millionth
    of a whole number is that number: 2.5 m by 0.1 m are 25 columns although ``2.5 / 0.1`` and
    ``0.3 / 0.1`` may lie just beside a whole number in binary. ``bins_per_m`` is ``1 / bin_m``,
    lowered by the few float32 steps (mostly none) that keep every counted point within the last
    row and column.
    """

    radius_m: float
    """Horizontal reach ``a_max``."""
    height_m: float
    """Reach ``h`` below the origin."""
    bin_m: float
    """Side ``rho`` of a bin."""
    radius_sq: np.float32
    """Least float32 whose root in float32 reaches the radius: the bound on ``a2``."""
    height: np.float32
    """``height_m`` in float32, the bound on ``b``."""
    bins_per_m: np.float32
    rows: np.int32
    """Number of depth bins, n; 32 bits as the kernels' bin numbers."""
    cols: np.int32
    """Number of distance bins, m."""

    @classmethod
    def of(cls, radius_m: float, height_m: float, bin_m: float) -> SpinGrid:
        """Grid of these sizes; ``ValueError`` unless they are positive and make few enough bins."""
        sizes = {"radius_m": radius_m, "height_m": height_m, "bin_m": bin_m}
        for name, value in sizes.items():
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"SpinGrid: {name} is {value}; it must be a positive number")
        rows, cols = _ceil_quotient(height_m, bin_m), _ceil_quotient(radius_m, bin_m)
        if rows * cols > MAX_BINS:
            raise ValueError(
                f"SpinGrid: {rows} x {cols} bins are more than {MAX_BINS}; use larger bins"
            )
        zero, height, radius_sq = np.float32(0), np.float32(height_m), _square_bound(radius_m)
        farthest, deepest = np.sqrt(np.nextafter(radius_sq, zero)), np.nextafter(height, zero)
        bins_per_m = np.float32(1.0 / bin_m)
        while farthest * bins_per_m >= cols or deepest * bins_per_m >= rows:
            bins_per_m = np.nextafter(bins_per_m, zero)
        exact = (radius_sq, height, bins_per_m, np.int32(rows), np.int32(cols))
        return cls(radius_m, height_m, bin_m, *exact)

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)``."""
        return int(self.rows), int(self.cols)

    @property
    def k(self) -> int:
        """Number of bins, n * m."""
        return int(self.rows) * int(self.cols)


def _square_bound(radius_m: float) -> np.float32:
    radius = np.float32(radius_m)
    bound = radius * radius
    while np.sqrt(bound) >= radius:
        bound = np.nextafter(bound, np.float32(0))
    while np.sqrt(bound) < radius:
        bound = np.nextafter(bound, np.float32(np.inf))
    return bound


def _ceil_quotient(length: float, step: float) -> int:
    quotient = length / step
    return max(1, math.ceil(quotient - 1e-6 * max(1.0, quotient)))


def spin_image(points: NDArray[Any], origin: NDArray[Any], grid: SpinGrid) -> U32:
    """Count the points around one origin: the plain twin of the compiled kernels.

    Parameters
    ----------
    points : (N, 3) array
        Upright, z up, metres; taken as float32.
    origin : (3,) array
        Origin in the same frame; taken as float32.
    grid : SpinGrid

    Returns
    -------
    (rows, cols) uint32 array
        Row 0 is just below the origin, column 0 at the axis.
    """
    cloud = np.asarray(points, dtype=np.float32).reshape(-1, 3)
    centre = np.asarray(origin, dtype=np.float32)
    with np.errstate(over="ignore"):  # squares of far distances are infinite, hence outside
        dx = cloud[:, 0] - centre[0]
        dy = cloud[:, 1] - centre[1]
        depth = centre[2] - cloud[:, 2]
        a2 = dx * dx + dy * dy
    inside = (a2 < grid.radius_sq) & (depth > 0) & (depth < grid.height)
    col = (np.sqrt(a2[inside]) * grid.bins_per_m).astype(np.int64)
    row = (depth[inside] * grid.bins_per_m).astype(np.int64)
    counts = np.bincount(row * grid.cols + col, minlength=grid.k)
    return counts.astype(np.uint32).reshape(grid.shape)


def correlation(
    counts: NDArray[Any], template: NDArray[Any], weights: NDArray[Any] | None = None
) -> float:
    """Weighted linear (Pearson) correlation of two images [Bovenkamp 2010, section 2.2].

    With means ``c_``, ``t_`` over the weights ``w``: ``sum w (c - c_) (t - t_)`` divided by the
    root of ``sum w (c - c_)^2 * sum w (t - t_)^2``. Bins of weight 0 are masked out. An image that
    is constant (empty, say) where it is weighted resembles nothing: its correlation is 0.

    Parameters
    ----------
    counts, template : (rows, cols) array
    weights : (rows, cols) array, optional
        Not negative; all equal if not given.

    Returns
    -------
    float
        Between -1 and 1. Sums are exactly rounded (``math.fsum``), so in no particular order.
    """
    c = np.asarray(counts, dtype=np.float64).ravel()
    t = np.asarray(template, dtype=np.float64).ravel()
    w = np.ones_like(c) if weights is None else np.asarray(weights, dtype=np.float64).ravel()
    total = math.fsum(w)
    if total <= 0:
        return 0.0
    dc = c - math.fsum(w * c) / total
    dt = t - math.fsum(w * t) / total
    var_c, var_t = math.fsum(w * dc * dc), math.fsum(w * dt * dt)
    if is_flat(var_c, math.fsum(w * c * c)) or is_flat(var_t, math.fsum(w * t * t)):
        return 0.0
    r = math.fsum(w * dc * dt) / (math.sqrt(var_c) * math.sqrt(var_t))
    return min(1.0, max(-1.0, r))


def is_flat(variance: float, mean_square: float) -> bool:
    """Whether an image counts as constant, from its variance and its mean square."""
    return variance <= FLAT_VARIANCE * mean_square
