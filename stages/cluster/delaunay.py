"""Groups of points by Delaunay tessellation [Bovenkamp 2010, section 2.3]."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError

from spinpipe.schemas.arrays import F64, I64

_FLAT = 1e-9


def delaunay_components(points: NDArray[np.floating], max_edge_m: float) -> I64:
    """Connected components of the Delaunay tessellation without its long edges.

    The tessellation holds a minimum spanning tree, so two points are in one component exactly if
    steps of at most ``max_edge_m`` from point to point lead from one to the other. Points that
    fill fewer dimensions than three (all in a plane, on a line) are tessellated there.

    Parameters
    ----------
    points : (N, 3)
        Metres; may be empty, and may hold equal points.
    max_edge_m : float
        Longest edge that still connects.

    Returns
    -------
    (N,) int64
        Component of each point, numbered in order of first appearance.
    """
    if len(points) == 0:
        return np.empty(0, np.int64)
    unique, inverse = np.unique(points.astype(np.float64), axis=0, return_inverse=True)
    edges = _edges(unique)
    length = np.linalg.norm(unique[edges[:, 0]] - unique[edges[:, 1]], axis=1)
    kept = edges[length <= max_edge_m]
    graph = coo_array((np.ones(len(kept)), (kept[:, 0], kept[:, 1])), shape=(len(unique),) * 2)
    labels = connected_components(graph, directed=False)[1][inverse.ravel()]
    _, first, renumbered = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[renumbered.ravel()].astype(np.int64)


def _edges(points: F64) -> I64:
    """(E, 2) edges of the tessellation of distinct points, in as many dimensions as they fill."""
    centred = points - points.mean(axis=0)
    _, spread, axes = np.linalg.svd(centred, full_matrices=False)
    dimensions = int(np.sum(spread > _FLAT * max(float(spread[0]), 1e-300)))
    flat = centred @ axes[:dimensions].T
    if len(points) <= dimensions + 1:
        return np.argwhere(np.triu(np.ones((len(points),) * 2), 1)).astype(np.int64)
    if dimensions == 1:
        order = np.argsort(flat[:, 0])
        return np.stack([order[:-1], order[1:]], axis=1).astype(np.int64)
    try:
        simplices = Delaunay(flat).simplices
    except QhullError:
        simplices = Delaunay(flat, qhull_options="QJ").simplices  # nearly flat: joggled
    corners = simplices.shape[1]
    pairs = [simplices[:, [i, j]] for i in range(corners) for j in range(i + 1, corners)]
    return np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0).astype(np.int64)
