"""What the points and the cameras say for a plane as the ground.

Each piece of evidence is a number in -1..1: how much more speaks for the plane with its normal
up than against it, 0 where nothing does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError

from spinpipe.schemas.arrays import F64, I32, I64, Mask
from spinpipe.stages.ground.plane import FittedPlane

REACH_VOXELS = 2.0
"""Sample points within this many voxels of each other belong together."""
SLOPE_DEG = 20.0
"""Ground may slope by this much against its plane."""
FEW = 10
"""Points of the sample (or the share of the ground below) that count as nothing in a vote."""
FEW_SHARE = 0.002
SPECK = 5
"""Groups of fewer points of the sample are noise, not scene."""
BAND = 4 / 3
"""Height in inlier distances that noise does not reach: four standard deviations."""
PART = 0.1
"""A group belongs to a plane if the plane holds this share of it, or it of the plane."""
ROLLED_DEG = 10.0
"""Cameras with more roll (root mean square) are not held level."""
TURNED_DEG = 15.0
"""Cameras that turn by less (root mean square) do not tell the axis they turn about."""
TILT_DEG = 20.0
"""The ground may be tilted by this much against the vertical of the cameras."""
HEIGHT_POINTS = 8
"""Nearest points of the ground, which give its height at a point; on the level next to it."""


@dataclass(frozen=True)
class Surface:
    """A sample of the scene, uniform in area and without specks."""

    points: F64
    """(N, 3)."""
    normals: F64
    """(N, 3) unit normals of either sign."""
    pairs: I64
    """(E, 2) rows of points within ``REACH_VOXELS`` voxels of each other."""
    voxel: float

    def groups(self, members: Mask) -> I32:
        """Label of the connected group of each member, in the order of the members."""
        n = len(members)
        within = self.pairs[members[self.pairs].all(axis=1)]
        graph = coo_array((np.ones(len(within), np.int8), (within[:, 0], within[:, 1])), (n, n))
        labels = connected_components(graph, directed=False)[1][members]
        return np.unique(labels, return_inverse=True)[1].astype(np.int32)


def solid_surface(points: F64, normals: F64, voxel: float) -> Surface:
    """Leave the specks out of a sample and connect its neighbours.

    Parameters
    ----------
    points
        (N, 3) sample, uniform in area.
    normals
        (N, 3) unit normals of either sign.
    voxel
        Spacing of the sample.
    """
    pairs = KDTree(points).query_pairs(REACH_VOXELS * voxel, output_type="ndarray")
    everything = Surface(points, normals, pairs, voxel)
    labels = everything.groups(np.ones(len(points), bool))
    solid = np.bincount(labels)[labels] >= SPECK
    if not solid.any():
        return everything
    renumbered = np.cumsum(solid) - 1
    pairs = renumbered[pairs[solid[pairs].all(axis=1)]]
    return Surface(points[solid], normals[solid], pairs, voxel)


def _vote(favour: float | np.intp, against: float | np.intp, few: float) -> float:
    return float((favour - against) / (favour + against + few))


@dataclass(frozen=True)
class Terrain:
    """A plane as the ground, grown over the gentle slopes and steps that continue it."""

    up: F64
    """(3,) unit vector: the vertical, not the plane's own normal."""
    plane: FittedPlane
    members: Mask
    """(N,) points of the surface that are ground."""
    heights: F64
    """(N,) above the ground nearby; the ground itself is at 0."""
    band: float
    """Heights within this are the ground's own roughness."""
    inside: Mask
    """(N,) points over the outline of the ground."""
    steepness: F64
    """(N,) squared sine of the surface's angle with the ground: 0 parallel, 1 upright."""
    touching: Mask
    """(N,) points next to the ground."""

    def level(self, points: F64) -> FittedPlane:
        """The level plane at the median height of the ground among (N, 3) points."""
        height = float(np.median(points[self.members] @ self.up))
        return FittedPlane(self.up, -height, self.plane.inlier_distance)

    @property
    def few(self) -> float:
        """Points that count as nothing beside this ground."""
        return FEW + FEW_SHARE * np.count_nonzero(self.members)

    def flipped(self) -> Terrain:
        """Return the same ground seen from its other side."""
        return replace(self, up=-self.up, plane=self.plane.flipped(), heights=-self.heights)


def grow_terrain(surface: Surface, up: F64, plane: FittedPlane) -> Terrain:
    """Find the ground that a plane is a part of.

    Points whose normals are within ``SLOPE_DEG`` of the vertical form connected groups; a group
    that the plane runs through belongs to the ground, and so does one that is large, on whatever
    level. So hills, kerbs and terraces are ground while bonnets and small roofs, which steep sides
    cut off, are not.
    """
    from_plane = plane.heights(surface.points)
    inliers = np.abs(from_plane) < plane.inlier_distance
    parallel = np.abs(surface.normals @ up)
    gentle = parallel > np.cos(np.radians(SLOPE_DEG))
    labels = surface.groups(gentle)
    hit = inliers[gentle]
    sizes = np.bincount(labels, minlength=1)
    hits = np.bincount(labels, weights=hit, minlength=1)
    part = (hits >= SPECK) & ((hits >= PART * sizes) | (hits >= PART * hit.sum()))
    part |= sizes >= PART * sizes.max()
    members = inliers.copy()
    members[gentle] |= part[labels]
    flat, along = surface.points @ np.linalg.svd(up[None])[2][1:].T, surface.points @ up
    about = min(HEIGHT_POINTS, np.count_nonzero(members))
    ranks: Any = [*range(1, about + 1)]  # a list: with an axis of neighbours even for one
    _, below = KDTree(surface.points[members]).query(surface.points[~members], k=ranks)
    heights = np.zeros(len(members))
    heights[~members] = along[~members] - np.median(along[members][below], axis=1)
    band = max(BAND * plane.inlier_distance, surface.voxel)
    near = band + REACH_VOXELS * surface.voxel
    gap, _ = KDTree(surface.points[members]).query(surface.points, distance_upper_bound=near)
    return Terrain(
        up,
        plane,
        members,
        heights,
        band,
        inside=_over_outline(surface, members, flat, band),
        steepness=1 - parallel**2,
        touching=gap < near,
    )


def distinct_terrains(surface: Surface, up: F64, planes: list[FittedPlane]) -> list[Terrain]:
    """Grow every plane into ground and keep one plane, the largest, of each ground.

    Facets of a hill, or the tops of things where noise joins them to the ground, grow into the
    ground that another plane fits better.
    """

    def inliers(plane: FittedPlane) -> int:
        return int(np.count_nonzero(np.abs(plane.heights(surface.points)) < plane.inlier_distance))

    kept: list[Terrain] = []
    for plane in sorted(planes, key=inliers, reverse=True):
        if inliers(plane) == 0:
            continue
        terrain = grow_terrain(surface, up, plane)
        size = np.count_nonzero(terrain.members)
        shared = [np.count_nonzero(terrain.members & other.members) for other in kept]
        if max(shared, default=0) <= 0.5 * size:
            kept.append(terrain)
    return kept


def _over_outline(surface: Surface, members: Mask, flat: F64, band: float) -> Mask:
    """Which points lie over the convex outline of the ground, in the plane's axes."""
    labels = surface.groups(members)
    sizes = np.bincount(labels, minlength=1)
    # Other surfaces that cross the plane leave small groups far outside its outline.
    core = flat[members][sizes[labels] >= PART * sizes.max()] if len(labels) else flat[:0]
    try:
        edges = ConvexHull(core).equations
    except (QhullError, ValueError):
        return np.zeros(len(flat), bool)
    outside = (flat @ edges[:, :2].T + edges[:, 2]).max(axis=1)
    return outside < REACH_VOXELS * surface.voxel + band


def scene_evidence(surface: Surface, terrains: Sequence[Terrain]) -> list[dict[str, float]]:
    """Ask the points about each terrain as the ground, its normal as up.

    - ``points above``: what lies over the ground's outline is above the ground, not below it.
    - ``points over``: what lies above the ground stands over its outline, not beside it.
    - ``points standing``: the clutter that belongs to no plane stands on the ground, with upright
      sides (another level of the ground has none).

    Parameters
    ----------
    surface
        The scene.
    terrains
        Every distinct plane of the scene.
    """
    clutter = np.ones(len(surface.points), bool)
    for terrain in terrains:
        clutter &= ~terrain.members
        clutter &= (
            np.abs(terrain.plane.heights(surface.points)) > BAND * terrain.plane.inlier_distance
        )
    labels = surface.groups(clutter)
    result: list[dict[str, float]] = []
    for terrain in terrains:
        inside = terrain.inside
        above, below = terrain.heights > terrain.band, terrain.heights < -terrain.band
        over, under = np.count_nonzero(above & inside), np.count_nonzero(below & inside)
        beside = np.count_nonzero(above & ~inside)
        standing = 0.0
        if len(labels):
            standing = _standing(terrain, clutter, labels)
        evidence = {
            "points above": _vote(over, under, terrain.few),
            "points over": _vote(over, beside, terrain.few),
            "points standing": standing,
        }
        result.append(evidence)
    return result


def _standing(terrain: Terrain, clutter: Mask, labels: I32) -> float:
    """Let the groups of clutter vote for the side of the ground they stand on, or against it.

    Things do not float: a group that does not touch the ground votes against it. Each counts by
    the root of its upright area, so that many things outvote one large ditch or bank.
    """
    upright = terrain.steepness[clutter]
    areas = np.bincount(labels, weights=upright)
    sides = np.bincount(labels, weights=upright * np.sign(terrain.heights[clutter]))
    touching = np.bincount(labels, weights=terrain.touching[clutter]) > 0
    roots = np.sqrt(np.maximum(areas, np.finfo(float).tiny))
    votes = np.where(touching, sides / roots, -roots)
    return float(votes.sum() / (roots.sum() + np.sqrt(terrain.few)))


def camera_up(rotations: F64) -> F64 | None:
    """Find the up of level cameras: the axis that they turn about.

    Photos are rarely rolled, so the cameras' x axes are horizontal; their common normal is the
    eigenvector of the smallest eigenvalue of the sum of ``x x^T`` [Brown & Lowe 2007, section 5].

    Parameters
    ----------
    rotations
        (C, 3, 3) camera to scene; -y of a camera is its own up.

    Returns
    -------
    ndarray or None
        (3,) unit vector; None where the cameras are rolled, or turn too little to tell (a flight
        that looks straight down with one heading).
    """
    x = rotations[:, :, 0]
    values, vectors = np.linalg.eigh(x.T @ x / len(x))
    rolled, turned = np.sqrt(np.maximum(values[:2], 0))
    if rolled > np.sin(np.radians(ROLLED_DEG)) or turned < np.sin(np.radians(TURNED_DEG)):
        return None
    axis = vectors[:, 0]
    return -axis * np.copysign(1.0, rotations[:, :, 1].sum(axis=0) @ axis)


def camera_evidence(positions: F64, rotations: F64, plane: FittedPlane) -> dict[str, float]:
    """Ask the photos about a plane as the ground, its normal as up.

    - ``cameras above``: the cameras are above the ground.
    - ``cameras upright``: a camera's own up (-y) or its back (-z) points up: photos are taken
      upright, looking down, or between the two.
    - ``cameras level``: the normal is the axis that level cameras turn about, whatever its sign;
      0 at an angle of ``TILT_DEG``, and where there is no such axis.

    Parameters
    ----------
    positions
        (C, 3) camera centres.
    rotations
        (C, 3, 3) camera to the frame of the plane; a camera looks along +z, -y is up.
    """
    heights = plane.heights(positions)
    above = np.count_nonzero(heights > plane.inlier_distance)
    below = np.count_nonzero(heights < -plane.inlier_distance)
    back_and_up = -(rotations[:, :, 1] + rotations[:, :, 2]) @ plane.normal
    up = camera_up(rotations)
    level = 0.0
    if up is not None:
        tilt_deg = np.degrees(np.arccos(min(abs(float(up @ plane.normal)), 1.0)))
        level = float(max(1 - tilt_deg / TILT_DEG, -1))
    return {
        "cameras above": _vote(above, below, 1),
        "cameras upright": float(np.clip(back_and_up, -1, 1).sum()) / (len(positions) + 1),
        "cameras level": level,
    }
