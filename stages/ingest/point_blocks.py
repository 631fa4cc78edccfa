"""What is done to every point of a scene, compiled: one look at a block, in the file's order."""
# pyright: basic

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F32, F64, I64, U64, Mask
from spinpipe.stages.geometry.hashing import FACTORS

MORTON_BITS = 21
"""Of a coordinate's cell: three of them fill a word."""


@njit(cache=True, nogil=True)
def finite_rows(xyz: F64) -> tuple[int, Mask, F64, F64]:
    """Which of (N, 3) points float32 can hold, how many, their least and greatest coordinates."""
    good = np.empty(len(xyz), np.bool_)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    count = 0
    for i in range(len(xyz)):
        x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
        good[i] = (
            np.isfinite(np.float32(x)) & np.isfinite(np.float32(y)) & np.isfinite(np.float32(z))
        )
        if good[i]:
            count += 1
            low[0], low[1], low[2] = min(low[0], x), min(low[1], y), min(low[2], z)
            high[0], high[1], high[2] = max(high[0], x), max(high[1], y), max(high[2], z)
    return count, good, low, high


@njit(cache=True, nogil=True)
def hashed(xyz: F64, golden: np.uint64) -> U64:
    """64-bit hashes (N,) of finite coordinates (N, 3), see ``geometry.hashing.mix``."""
    bits = np.empty(1, np.float64)
    word = bits.view(np.uint64)
    hashes = np.empty(len(xyz), np.uint64)
    for i in range(len(xyz)):
        state = np.uint64(0)
        for axis in range(3):
            bits[0] = xyz[i, axis] + 0.0  # -0.0, which equals 0.0, into the same bits
            state = state + word[0] + golden
            state = (state ^ (state >> np.uint64(30))) * FACTORS[0]
            state = (state ^ (state >> np.uint64(27))) * FACTORS[1]
            state = state ^ (state >> np.uint64(31))
        hashes[i] = state
    return hashes


@njit(cache=True, nogil=True)
def to_local(xyz: F64, origin: F64, scale: F64, local: F32) -> None:
    """Scene -> local frame into (N, 3); 0 added turns -0.0 into 0.0: equal points, equal bits."""
    for i in range(len(xyz)):
        for axis in range(3):
            moved = np.float32((xyz[i, axis] - origin[axis]) * scale[axis])
            local[i, axis] = moved + np.float32(0)


@njit(cache=True, nogil=True)
def descend(xyz: F32, axes: I64, cuts: F32, depth: int, leaf: NDArray) -> None:
    """Leaf (N,) of each of the points (N, 3) in a complete tree of cuts, see ``KdSplit``."""
    first = (1 << depth) - 1
    for i in range(len(xyz)):
        node = 0
        for _ in range(depth):
            node = 2 * node + 1 + (xyz[i, axes[node]] >= cuts[node])
        leaf[i] = node - first


@njit(cache=True, nogil=True)
def morton_keys(xyz: F32, low: F32, cells_per_m: float) -> U64:
    """Number (N,) of each point's cell along a Morton curve [Morton 1966]."""
    keys = np.empty(len(xyz), np.uint64)
    for i in range(len(xyz)):
        key = np.uint64(0)
        for axis in range(3):
            cell = np.uint64(np.float64(xyz[i, axis] - low[axis]) * cells_per_m)
            cell = (cell | cell << np.uint64(32)) & np.uint64(0x1F00000000FFFF)
            cell = (cell | cell << np.uint64(16)) & np.uint64(0x1F0000FF0000FF)
            cell = (cell | cell << np.uint64(8)) & np.uint64(0x100F00F00F00F00F)
            cell = (cell | cell << np.uint64(4)) & np.uint64(0x10C30C30C30C30C3)
            cell = (cell | cell << np.uint64(2)) & np.uint64(0x1249249249249249)
            key |= cell << np.uint64(axis)
        keys[i] = key
    return keys
