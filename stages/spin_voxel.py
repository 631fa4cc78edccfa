"""Coarse to fine: one origin in each voxel first, then every origin near the promising ones.

An approximation, unlike ``spin_pruning``: a hit is lost when no chosen origin near it comes
within ``margin`` of the least correlation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from spinpipe.stages.spin_image import SpinTemplate
from spinpipe.stages.spin_index import SpinIndex
from spinpipe.stages.spin_kernel import BELOW, ScanWork, correlate


def correlate_near_promising(
    index: SpinIndex,
    origins: NDArray[Any],
    coarse: NDArray[Any],
    templates: Sequence[SpinTemplate],
    threads: int = 1,
    *,
    min_correlation: float,
    reach_m: float,
    margin: float = 0.2,
    advance: Callable[[int], None] | None = None,
    work: ScanWork | None = None,
) -> NDArray[np.float32]:
    """Hits among the origins that lie near a promising coarse origin.

    Parameters
    ----------
    index : SpinIndex
    origins : (M, 3) array
        In the index's frame, metres.
    coarse : (K, 3) array
        Origins tried first, one in each voxel. To be independent of tiles they include those of
        the voxels within ``reach_m`` around the tile's own.
    templates : sequence of SpinTemplate
    threads : int
    min_correlation : float
        Least correlation of a hit, greater than ``margin``.
    reach_m : float
        How far a promising coarse origin speaks for others: the voxels' diagonal, say.
    margin : float
        How much lower the correlation of a promising coarse origin may be.
    advance, work
        As for ``correlate``; an origin counts once it is scanned or left out.

    Returns
    -------
    (len(templates), M) float32 array
        Correlations of at least ``min_correlation``, ``BELOW`` for all others.
    """
    first = correlate(
        index, coarse, templates, threads, min_correlation=min_correlation - margin, work=work
    )
    promising = np.asarray(coarse)[(first > BELOW).any(axis=0)]
    found = np.full((len(templates), len(origins)), BELOW)
    near = np.zeros(len(origins), bool)
    if len(promising) and len(origins):
        distance = KDTree(promising).query(origins, distance_upper_bound=reach_m)[0]
        near = np.isfinite(distance)
    if advance is not None:
        advance(int((~near).sum()))
    found[:, near] = correlate(
        index,
        np.asarray(origins)[near],
        templates,
        threads,
        min_correlation=min_correlation,
        advance=advance,
        work=work,
    )
    return found
