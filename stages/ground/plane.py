"""Planes in a point sample: RANSAC with local optimisation, refined to convergence.

[Fischler & Bolles 1981] for the scheme and its number of trials, [Torr & Zisserman 2000] for the
truncated quadratic score (MSAC), [Chum, Matas & Kittler 2003] for refining the best hypotheses
before they are compared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

F64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

BATCH = 256
SCORED = 2048
"""Points that score a hypothesis; finalists are refined on eight times as many, the best on all."""
FINALISTS = 8
GAUSSIAN_MAD = 1.4826
"""Standard deviation of a normal distribution in units of its median absolute deviation."""
PARALLEL = np.cos(np.radians(20.0))
"""Least cosine of the angle between parallel normals; 0.06 of random normals are parallel."""
NEIGHBOURS, MOST = 16, 64
"""Points in a local plane: to begin with, and where noise asks for more."""
NORMAL_ERROR = np.radians(4.0)
"""Standard error of normals that are known: a fifth of ``PARALLEL``."""
SMOOTHEST = 0.1
"""Share of the surface that is smooth in every scene."""
TRIED = 4096
"""Points that tell whether neighbourhoods are wide enough."""
LEAST_SUPPORT = 500
"""Points of which neighbourhoods are made at least."""
CHUNK = 8192
"""Points whose neighbourhoods are held at once."""
SIGMAS = 3.0
"""Inlier distance in standard deviations of the noise."""


@dataclass(frozen=True)
class FittedPlane:
    """``dot(normal, p) + offset = 0`` with a unit normal of either sign."""

    normal: F64
    offset: float
    inlier_distance: float
    """Points nearer than this are inliers: three standard deviations of their noise."""

    def heights(self, points: F64) -> F64:
        """Signed distances of (N, 3) points from the plane."""
        return points @ self.normal + self.offset

    def flipped(self) -> FittedPlane:
        """Return the same plane with its normal on the other side."""
        return FittedPlane(-self.normal, -self.offset, self.inlier_distance)


@dataclass(frozen=True)
class LocalPlanes:
    """The plane of each point and its nearest neighbours."""

    normals: F64
    """(N, 3) unit normals of either sign."""
    deviations: F64
    """(N,) standard deviation of the neighbours from the plane."""
    errors: F64
    """(N,) standard error of the normals about the axis that is known worst, radians."""


def local_planes(
    points: F64, *, neighbours: int = 16, support: F64 | None = None, rows: int | None = None
) -> LocalPlanes:
    """Principal components of each point's nearest neighbours [Hoppe et al. 1992].

    Parameters
    ----------
    points
        (N, 3), N >= 4.
    neighbours
        Points in each plane.
    support
        (M, 3) points that the neighbours are taken from; the points themselves if not stated.
    rows
        How many of the points, from the first, get a plane; all if not stated.
    """
    support = points if support is None else support
    neighbours = min(neighbours, len(support))
    tree = KDTree(support)
    parts = [
        _principal_planes(support[tree.query(part, k=neighbours)[1]])
        for part in np.split(points[:rows], range(CHUNK, len(points[:rows]), CHUNK))
    ]
    return LocalPlanes(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _principal_planes(patches: F64) -> tuple[F64, F64, F64]:
    """Normals, deviations and errors of (N, K, 3) patches.

    The error is that of a sample's eigenvector towards the next one [Anderson 1963, theorem 1]:
    it grows without bound as a patch gets as thick as it is wide.
    """
    count = patches.shape[1]
    patches = patches - patches.mean(axis=1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", patches, patches))
    least, middle = np.maximum(values[:, 0], 0), np.maximum(values[:, 1], 0)
    # Three parameters were fitted to each patch.
    deviations = np.sqrt(least / max(count - 3, 1))
    gap = np.maximum(middle - least, np.finfo(float).tiny)
    return vectors[:, :, 0], deviations, np.sqrt(least / gap * (middle / gap) / count)


def reliable_local_planes(points: F64) -> LocalPlanes:
    """Local planes in neighbourhoods that are wide against the noise.

    A ball that is no wider than the noise is thick holds a round heap of points, whose normal is
    chance and whose deviation says how large the ball is, not how large the noise. So the number
    of neighbours doubles until the smoothest patches know their normals; beyond ``MOST`` of them
    every other point is left out, which widens the ball at the same cost.

    Parameters
    ----------
    points
        (N, 3), N >= 4, in random order.
    """
    neighbours, support = NEIGHBOURS, points
    while True:
        tried = local_planes(points, neighbours=neighbours, support=support, rows=TRIED)
        if np.quantile(tried.errors, SMOOTHEST) <= NORMAL_ERROR:
            break
        if neighbours < MOST:
            neighbours *= 2
        elif len(support) >= 2 * LEAST_SUPPORT:
            support = support[: len(support) // 2]
        else:
            break  # a volume: it has no planes, however wide one looks
    return local_planes(points, neighbours=neighbours, support=support)


def is_collinear(points: F64, *, tolerance: float = 1e-6) -> bool:
    """Whether (N, 3) points span no plane."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return len(spread) < 2 or bool(spread[1] <= tolerance * spread[0])


def _hypotheses(points: F64, rng: np.random.Generator, count: int) -> tuple[F64, F64]:
    """Planes through ``count`` random triples: (H, 3) unit normals and (H,) offsets."""
    triples = points[rng.integers(len(points), size=(count, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    proper = lengths > 0
    normals = normals[proper] / lengths[proper, None]
    return normals, -np.einsum("hi,hi->h", normals, triples[proper, 0])


def _trials(share: float, confidence: float) -> float:
    """Triples after which one was all inliers with ``confidence`` [Fischler & Bolles 1981]."""
    return 1.0 if share >= 1 else float(np.log1p(-confidence) / np.log1p(-(share**3)))


def msac_score(heights: F64, distance: float) -> F64:
    """Sum the truncated quadratic scores of (N, ...) residuals over N [Torr & Zisserman 2000]."""
    return np.maximum(1 - (heights / distance) ** 2, 0).sum(axis=0)


def refine_plane(
    points: F64,
    plane: FittedPlane,
    *,
    window: float = 2.0,
    widest: float = 2.0,
    fixed_distance: bool = False,
    rounds: int = 50,
) -> FittedPlane:
    """Least squares on the inliers to convergence, with Tukey's weights and a robust scale.

    The inlier distance follows the spread of the residuals within ``window`` (median absolute
    deviation), so that a surface that is rougher at large than locally still counts as one plane.

    Parameters
    ----------
    points
        (N, 3), all of the sample.
    plane
        First guess.
    window
        In inlier distances; infinite where all points are known to be one surface.
    widest
        Largest inlier distance, relative to the one of the first guess.
    fixed_distance
        Keep the inlier distance as given.
    rounds
        Most iterations.
    """
    first = plane.inlier_distance
    for _ in range(rounds):
        heights = plane.heights(points)
        distance = plane.inlier_distance
        if not fixed_distance:
            near = np.abs(heights[np.abs(heights) < window * distance])
            if len(near) >= 3:
                spread = SIGMAS * GAUSSIAN_MAD * float(np.median(near))
                distance = float(np.clip(spread, first, widest * first))
        weights = np.maximum(1 - (heights / distance) ** 2, 0) ** 2
        if np.count_nonzero(weights) < 3:
            return plane
        centre = weights @ points / weights.sum()
        arms = points - centre
        normal = np.linalg.eigh(arms.T @ (arms * weights[:, None]))[1][:, 0]
        normal *= np.copysign(1.0, normal @ plane.normal)
        refined = FittedPlane(normal, -float(normal @ centre), distance)
        moved = np.abs(refined.heights(points) - heights).max()
        plane = refined
        if moved < 1e-4 * distance:
            break
    return plane


def ransac_plane(
    points: F64,
    distance: float,
    rng: np.random.Generator,
    *,
    min_share: float,
    confidence: float = 0.999,
    fixed_distance: bool = False,
) -> FittedPlane:
    """Find the plane with the best truncated quadratic score.

    Parameters
    ----------
    points
        (N, 3), N >= 3, in random order (the first ones score the hypotheses).
    distance
        Inlier distance.
    rng
        Draws the triples.
    min_share
        Least share of the points that the plane must hold to be of use.
    confidence
        Stop when a triple of inliers of such a plane was drawn with this probability.
    fixed_distance
        Keep the inlier distance as given while refining.

    Raises
    ------
    ValueError
        If no triple spans a plane.
    """
    scored = points[:SCORED]
    finalists: list[tuple[float, FittedPlane]] = []
    needed, drawn = _trials(min_share, confidence), 0
    while drawn < needed:
        normals, offsets = _hypotheses(points, rng, BATCH)
        drawn += BATCH
        if len(normals) == 0:
            continue
        heights = scored @ normals.T + offsets
        scores = msac_score(heights, distance)
        for h in np.argsort(-scores, kind="stable")[:FINALISTS]:
            finalists.append(
                (float(scores[h]), FittedPlane(normals[h], float(offsets[h]), distance))
            )
        finalists = sorted(finalists, key=lambda entry: -entry[0])[:FINALISTS]
        best = np.abs(finalists[0][1].heights(scored)) < distance
        needed = _trials(max(float(best.mean()), min_share), confidence)
    if not finalists:
        raise ValueError("no three points span a plane")
    judges = points[: 8 * SCORED]
    refined = [refine_plane(judges, p, fixed_distance=fixed_distance) for _, p in finalists]
    best = max(refined, key=lambda p: float(msac_score(p.heights(judges), distance)))
    # Not wider than the finalists were allowed to be: clutter must not widen a plane step by step.
    widest = 2.0 * distance / best.inlier_distance
    return refine_plane(points, best, widest=widest, fixed_distance=fixed_distance)


def ransac_planes(
    points: F64,
    normals: F64,
    distance: float,
    rng: np.random.Generator,
    *,
    count: int,
    min_share: float,
    confidence: float = 0.999,
    fixed_distance: bool = False,
) -> list[FittedPlane]:
    """Find the largest planes one after the other, each found among the points that are left.

    Points within twice the inlier distance of a plane are taken out with it, or the next plane
    would be the edge of its noise.

    Parameters
    ----------
    points
        (N, 3), in random order.
    normals
        (N, 3) unit normals of the surface at the points, of either sign.
    distance
        Inlier distance.
    rng
        Draws the triples.
    count
        Most planes.
    min_share
        Least share of the points that a plane must hold.
    confidence, fixed_distance
        As for ``ransac_plane``.

    Returns
    -------
    list of FittedPlane
        At most ``count``, each refined. At least ``min_share`` of the points are inliers that lie
        on surfaces parallel to it, and they are at least half of its inliers: a plane holds
        neither what it merely cuts (walls, legs) nor a volume.
    """
    planes: list[FittedPlane] = []
    left, directions = points, normals
    for _ in range(count):
        if len(left) < max(3, min_share * len(points)) or is_collinear(left):
            break
        plane = ransac_plane(
            left,
            distance,
            rng,
            min_share=min_share * len(points) / len(left),
            confidence=confidence,
            fixed_distance=fixed_distance,
        )
        heights = np.abs(plane.heights(left))
        if np.count_nonzero(heights < plane.inlier_distance) < min_share * len(points):
            break
        inliers = heights < plane.inlier_distance
        held = np.count_nonzero(np.abs(directions[inliers] @ plane.normal) > PARALLEL)
        if held >= max(min_share * len(points), 0.5 * np.count_nonzero(inliers)):
            planes.append(plane)
        rest = heights >= 2 * plane.inlier_distance
        left, directions = left[rest], directions[rest]
    return planes
