"""What a scan looks for: the spin images of the models and how much each bin counts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F64, I32, Mask
from spinpipe.stages.geometry.model_surface import topmost_point
from spinpipe.stages.scan.image import SpinGrid, is_flat, spin_image

LARGEST_PART = 2**30
"""Integer that stands for a template's largest value: a product of counts then fits 63 bits."""
EXTENT_MARGIN_BINS = 1
"""Bins beyond the model's farthest point that still belong to it: noise carries points there."""


class Templates(NamedTuple):
    """Images of T models on one grid of k bins; made by ``Templates.of``.

    The correlation of counts ``c`` with a template is the sum of ``c * values`` divided by the
    weighted standard deviation of ``c``.
    """

    grid: SpinGrid
    images: F64
    """(T, rows, cols)"""
    weights: F64
    """(T, k), of sum 1."""
    even: Mask
    """(T,) whether all bins weigh alike."""
    alike: Mask
    """(T,) whether the weights are those of the template before."""
    values: F64
    """(T, k) weights times the image brought to weighted mean 0 and weighted square sum 1; all 0
    where the image is constant, so that its correlations are 0."""
    parts: I32
    """(T, k) the same in whole multiples of ``unit``."""
    unit: F64
    """(T,)"""

    @classmethod
    def of(
        cls,
        grid: SpinGrid,
        images: Sequence[NDArray[Any]],
        weights: Sequence[NDArray[Any] | None] | None = None,
    ) -> Templates:
        """Templates of images (rows, cols), each with weights of that shape or None for even ones.

        Raises
        ------
        ValueError
            A shape does not fit the grid, a number is not finite, weights are negative or all zero.
        """
        given = [None] * len(images) if weights is None else list(weights)
        shape = (len(images), *grid.shape)
        chosen = np.ones(shape)
        for row, weight in enumerate(given):
            if weight is not None:
                chosen[row] = _checked("weights", weight, grid)
        if (chosen < 0).any() or not chosen.any(axis=(1, 2)).all():
            raise ValueError("Templates: weights must not be negative nor all zero")
        stack = np.array([_checked("image", image, grid) for image in images]).reshape(shape)
        w = chosen.reshape(len(images), grid.k)
        w /= np.array([math.fsum(row) for row in w])[:, None]
        lines = zip(w, stack.reshape(w.shape), strict=True)
        values = np.array([weight * _unit(image, weight) for weight, image in lines])
        values = values.reshape(w.shape)
        alike = np.zeros(len(w), np.bool_)
        alike[1:] = (w[1:] == w[:-1]).all(axis=1)
        unit = np.maximum(np.abs(values).max(axis=1, initial=0.0), 1e-300) / LARGEST_PART
        parts = np.rint(values / unit[:, None]).astype(np.int32)
        even = np.array([weight is None for weight in given], np.bool_)
        return cls(grid, stack, w, even, alike, values, parts, unit)

    @property
    def size(self) -> int:
        """Number of templates."""
        return len(self.unit)


def _checked(name: str, array: NDArray[Any], grid: SpinGrid) -> F64:
    values = np.asarray(array, dtype=np.float64)
    if values.shape != grid.shape:
        raise ValueError(f"Templates: {name} of shape {values.shape}, the grid is {grid.shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"Templates: {name} with NaN or infinite numbers")
    return values


def _unit(image: F64, weights: F64) -> F64:
    """Bring an image (k,) to weighted mean 0 and weighted square sum 1; 0 if it is constant."""
    centred = image - math.fsum(weights * image)
    variance = math.fsum(weights * centred * centred)
    if is_flat(variance, math.fsum(weights * image * image)):
        return np.zeros(len(image))
    return centred / math.sqrt(variance)


def object_image(points: NDArray[Any], grid: SpinGrid, origin: NDArray[Any] | None = None) -> F64:
    """(rows, cols) spin image of an object at its topmost point [Bovenkamp 2010, section 2.1].

    Parameters
    ----------
    points : (N, 3) array
        The object's surface, object frame (z up), metres.
    origin : (3,) array, optional
        Another origin than the topmost point.

    Raises
    ------
    ValueError
        The cloud is empty or not finite.
    """
    cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    centre = topmost_point(cloud) if origin is None else np.asarray(origin, dtype=np.float64)
    # Metres around the origin in float64 first: an object may lie far from zero.
    return spin_image(cloud - centre, np.zeros(3), grid).astype(np.float64)


def extent_weights(image: NDArray[np.floating], outside: float) -> F64:
    """Weights 1 within the model's extent at each depth and ``outside`` beyond it.

    What stands beside an instance falls into bins that the model itself cannot reach. With weights
    below 1 there the correlation is masked: neighbours disturb it less, and so does what would tell
    the object from a larger one that contains its shape.

    Parameters
    ----------
    image : (rows, cols) array
        The model's spin image.
    outside : float
        0 masks the bins beyond the extent, 1 treats all bins alike.

    Returns
    -------
    (rows, cols) float64 array
    """
    columns = np.arange(image.shape[1])
    farthest = np.where(image > 0, columns, -1 - EXTENT_MARGIN_BINS).max(axis=1, keepdims=True)
    return np.where(columns <= farthest + EXTENT_MARGIN_BINS, 1.0, outside)
