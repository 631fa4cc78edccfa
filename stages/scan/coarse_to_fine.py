"""Coarse to fine: one origin in each voxel first, then every origin in and around promising ones.

An approximation, unlike ``pruning``: a hit is lost when no representative of its voxel or of
one that touches it comes within ``margin`` of the least correlation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spinpipe.schemas.arrays import F32, Mask
from spinpipe.stages.scan.correlate import BELOW, ScanWork, correlate
from spinpipe.stages.scan.index import SpinIndex
from spinpipe.stages.scan.templates import Templates
from spinpipe.stages.scan.voxels import Voxels

VOXEL_RADII = 1 / 8
"""Side of a voxel, in radii of the spin image: correlations change little within it."""
PROMISE_MARGIN = 0.2
"""How much lower the correlation of a promising voxel's representative may be."""


def halo_m(voxel_m: float) -> float:
    """How far around an origin points must be known for its result to be right, metres."""
    return 2.0 * voxel_m


def correlate_coarse_to_fine(
    index: SpinIndex,
    origins: F32,
    own: Mask,
    templates: Templates,
    threads: int = 1,
    *,
    min_correlation: float,
    voxel_m: float,
    margin: float = PROMISE_MARGIN,
    pruned: bool = False,
    advance: Callable[[int], None] | None = None,
    work: ScanWork | None = None,
) -> F32:
    """Correlations of the representatives and of all origins near promising ones.

    Parameters
    ----------
    index : SpinIndex
    origins : (M, 3) float32 array
        World, metres; those asked for and all others within ``halo_m`` of them.
    own : (M,) bool array
        Which of them are asked for.
    templates : Templates
    threads : int
    min_correlation : float
        Least correlation of a hit.
    voxel_m : float
        Side of a voxel.
    margin : float
        How much lower the correlation of a promising representative may be.
    pruned : bool
        Only hits (and promising representatives) are scored, see ``pruning``.
    advance, work
        As for ``correlate``; an origin counts once it is scanned or left out.

    Returns
    -------
    (T, own.sum()) float32 array
        ``BELOW`` for origins left out.
    """
    promise = min_correlation - margin
    voxels = Voxels.of(origins, voxel_m)
    rows = voxels.representatives
    found = np.full((templates.size, len(origins)), BELOW)
    found[:, rows] = correlate(
        index,
        origins[rows],
        templates,
        threads,
        min_correlation=promise if pruned and promise > 0 else None,
        work=work,
    )
    promising = rows[(found[:, rows] >= np.float32(promise)).any(axis=0)]
    rest = own & voxels.touching(promising)
    rest[rows] = False
    if advance is not None:
        advance(int((own & ~rest).sum()))
    found[:, rest] = correlate(
        index,
        origins[rest],
        templates,
        threads,
        min_correlation=min_correlation if pruned else None,
        advance=advance,
        work=work,
    )
    return found[:, own]
