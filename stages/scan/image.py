"""Spin images about the vertical, their correlation, and the plain numpy twin of the kernels.

A spin image counts the points around an origin by their distance from the vertical axis through
it and by their depth below it. It needs no normals and does not change when the object turns
about the vertical [Johnson & Hebert 1999; Bovenkamp 2010, section 2.1].

Everything here is float32 up to the counts, so that the compiled kernels can give the very same
integers; see ``SpinGrid`` for the exact rule.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.geometry.model_surface import topmost_point
from spinpipe.stages.scan.count import FLAT_VARIANCE

MAX_BINS = 60_000
"""Most bins of one grid: the kernels hold bin numbers in 16 bits."""


@dataclass(frozen=True)
class SpinGrid:
    """Extent and bins of a spin image [Bovenkamp 2010, section 2.1].

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

    Parameters
    ----------
    radius_m : float
        Horizontal reach ``a_max``, metres.
    height_m : float
        Reach ``h`` below the origin, metres.
    bin_m : float
        Side ``rho`` of a bin, metres.

    Raises
    ------
    ValueError
        A size is not a positive number, or the grid has more than ``MAX_BINS`` bins.
    """

    radius_m: float
    height_m: float
    bin_m: float

    def __post_init__(self) -> None:
        for name in ("radius_m", "height_m", "bin_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"SpinGrid: {name} is {value}; it must be a positive number")
        if self.k > MAX_BINS:
            raise ValueError(
                f"SpinGrid: {self.rows} x {self.cols} bins are more than {MAX_BINS}; "
                "use larger bins"
            )

    @property
    def rows(self) -> int:
        """Number of depth bins, n."""
        return _ceil_quotient(self.height_m, self.bin_m)

    @property
    def cols(self) -> int:
        """Number of distance bins, m."""
        return _ceil_quotient(self.radius_m, self.bin_m)

    @property
    def k(self) -> int:
        """Number of bins, n * m."""
        return self.rows * self.cols

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)``."""
        return self.rows, self.cols

    @cached_property
    def radius_sq(self) -> np.float32:
        """Least float32 whose root in float32 reaches the radius: the bound on ``a2``."""
        radius = np.float32(self.radius_m)
        bound = radius * radius
        while np.sqrt(bound) >= radius:
            bound = np.nextafter(bound, np.float32(0))
        while np.sqrt(bound) < radius:
            bound = np.nextafter(bound, np.float32(np.inf))
        return bound

    @property
    def height(self) -> np.float32:
        """Height in float32, the bound on ``b``."""
        return np.float32(self.height_m)

    @cached_property
    def bins_per_m(self) -> np.float32:
        """Factor from metres to bins in float32."""
        zero = np.float32(0)
        farthest = np.sqrt(np.nextafter(self.radius_sq, zero))
        deepest = np.nextafter(self.height, zero)
        factor = np.float32(1.0 / self.bin_m)
        while farthest * factor >= self.cols or deepest * factor >= self.rows:
            factor = np.nextafter(factor, zero)
        return factor


def _ceil_quotient(length: float, step: float) -> int:
    quotient = length / step
    return max(1, math.ceil(quotient - 1e-6 * max(1.0, quotient)))


def spin_image(points: NDArray[Any], origin: NDArray[Any], grid: SpinGrid) -> NDArray[np.uint32]:
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
    if _is_flat(var_c, math.fsum(w * c * c)) or _is_flat(var_t, math.fsum(w * t * t)):
        return 0.0
    r = math.fsum(w * dc * dt) / (math.sqrt(var_c) * math.sqrt(var_t))
    return min(1.0, max(-1.0, r))


def _is_flat(variance: float, mean_square: float) -> bool:
    return variance <= FLAT_VARIANCE * mean_square


@dataclass(frozen=True, eq=False)
class SpinTemplate:
    """What a scan looks for: the model's spin image and how much each bin counts.

    Parameters
    ----------
    grid : SpinGrid
    values : (rows, cols) array
        Kept as float64.
    weights : (rows, cols) array, optional
        Not negative, not all zero; None weighs all bins alike.

    Raises
    ------
    ValueError
        A shape does not fit the grid, a number is not finite, or the weights are unusable.
    """

    grid: SpinGrid
    values: NDArray[np.float64]
    weights: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        for name in ("values", "weights"):
            given = getattr(self, name)
            if given is None and name == "weights":
                continue
            array = np.array(given, dtype=np.float64)
            if array.shape != self.grid.shape:
                raise ValueError(
                    f"SpinTemplate: {name} have shape {array.shape}, the grid {self.grid.shape}"
                )
            if not np.isfinite(array).all():
                raise ValueError(f"SpinTemplate: {name} hold NaN or infinite numbers")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.weights is not None and (self.weights.min() < 0 or self.weights.max() <= 0):
            raise ValueError("SpinTemplate: weights must not be negative nor all zero")

    def unit_weights(self) -> NDArray[np.float64]:
        """Weights as a (k,) array whose sum is 1."""
        w = np.ones(self.grid.k) if self.weights is None else self.weights.ravel()
        return w / math.fsum(w)

    def unit_values(self) -> NDArray[np.float64]:
        """Values as a (k,) array with weighted mean 0 and weighted square sum 1.

        All zero where the template is constant, so that its correlations are 0.
        """
        w, t = self.unit_weights(), self.values.ravel()
        dt = t - math.fsum(w * t)
        variance = math.fsum(w * dt * dt)
        if _is_flat(variance, math.fsum(w * t * t)):
            return np.zeros(self.grid.k)
        return dt / math.sqrt(variance)


def template_from_cloud(
    points: NDArray[Any],
    grid: SpinGrid,
    *,
    origin: NDArray[Any] | None = None,
    weights: NDArray[Any] | None = None,
) -> SpinTemplate:
    """Spin image of an object at its topmost point [Bovenkamp 2010, section 2.1].

    Parameters
    ----------
    points : (N, 3) array
        The object's surface, object frame (z up), metres.
    grid : SpinGrid
    origin : (3,) array, optional
        Another origin than the topmost point.
    weights : (rows, cols) array, optional
        Weights of the bins, see ``SpinTemplate``.

    Raises
    ------
    ValueError
        The cloud is empty or not finite.
    """
    cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    centre = topmost_point(cloud) if origin is None else np.asarray(origin, dtype=np.float64)
    # Metres around the origin in float64 first: an object may lie far from zero.
    image = spin_image(cloud - centre, np.zeros(3), grid)
    return SpinTemplate(grid, image.astype(np.float64), weights)
