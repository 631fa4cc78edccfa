"""The planes of a scene: patches that lie in one plane, together, wherever they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spinpipe.schemas.arrays import F64, Mask
from spinpipe.stages.ground.patches import Patches

MOST = 300
"""Planes that are looked for, largest patches first; later ones are single patches."""
ROUNDS = 4
"""Fits of a plane to what lies in it; most settle after two."""
AGREE = np.radians(2.0)
"""Patches whose normals differ by less are of one plane if their offsets allow it."""
SIGMAS = 3.0
"""Distance of a plane's points in standard deviations."""
WAVES = 0.02
"""Height of a surface's waves relative to the width of a patch: paved ground, measured."""


@dataclass(frozen=True)
class Surfaces:
    """Planes of the scene, each the patches that lie in it."""

    normal: F64
    """(S, 3) unit, of either sign."""
    centre: F64
    """(S, 3)."""
    share: F64
    """(S,) of the scene's surface."""
    thickness: F64
    """(S,) standard deviation of the points along the normal."""
    error: F64
    """(S,) standard error of the normal, radians."""

    def __len__(self) -> int:
        """Number of surfaces."""
        return len(self.share)

    def at(self, rows: NDArray[np.intp] | Mask) -> Surfaces:
        """Some of them."""
        return Surfaces(
            self.normal[rows],
            self.centre[rows],
            self.share[rows],
            self.thickness[rows],
            self.error[rows],
        )


def scene_surfaces(patches: Patches, points: int) -> Surfaces:
    """Join coplanar patches, greedily from the largest, and fit one plane to each group.

    Parameters
    ----------
    patches
        Flat pieces of the scene.
    points
        Points of the sample that they were found in.

    Returns
    -------
    Surfaces
        Largest first.
    """
    left = np.ones(len(patches.points), bool)
    found: list[tuple[F64, F64, float, float, float]] = []
    for seed in np.argsort(-patches.points, kind="stable"):
        if len(found) == MOST:
            break
        if left[seed]:
            members, plane = _grown(patches, int(seed), left)
            left &= ~members
            found.append((*plane[:2], patches.points[members].sum() / points, *plane[2:]))
    if not found:
        return Surfaces(np.empty((0, 3)), np.empty((0, 3)), *(np.empty(0) for _ in range(3)))
    normal, centre, share, thickness, error = zip(*found, strict=True)
    surfaces = Surfaces(
        np.array(normal), np.array(centre), np.array(share), np.array(thickness), np.array(error)
    )
    return surfaces.at(np.argsort(-surfaces.share, kind="stable"))


def _grown(patches: Patches, seed: int, left: Mask) -> tuple[Mask, tuple[F64, F64, float, float]]:
    """Patches in the plane of one of them, and normal, centre, thickness and error of their fit."""
    members = np.zeros(len(left), bool)
    members[seed] = True
    plane = _fit(patches, members)
    tolerance = np.maximum(AGREE, SIGMAS * patches.error)
    reach = SIGMAS * patches.thickness + WAVES * patches.width
    for _ in range(ROUNDS):
        normal, centre, _, _ = plane
        parallel = np.abs(patches.normal @ normal) > np.cos(tolerance)
        near = np.abs((patches.centre - centre) @ normal) < reach
        grown = left & parallel & near
        grown[seed] = True
        if np.array_equal(grown, members):
            break
        members, plane = grown, _fit(patches, grown)
    return members, plane


def _fit(patches: Patches, members: Mask) -> tuple[F64, F64, float, float]:
    """Least squares through patches: between their centres, and in the plane of each."""
    weight = patches.points[members] / patches.points[members].sum()
    normals = patches.normal[members]
    centre = weight @ patches.centre[members]
    arms = patches.centre[members] - centre
    within = np.eye(3) - normals[:, :, None] * normals[:, None, :]
    scatter = arms.T @ (arms * weight[:, None])
    scatter += np.einsum("p,pij->ij", weight * patches.width[members] ** 2, within)
    values, vectors = np.linalg.eigh(scatter)
    normal = vectors[:, 0]
    variance = weight @ (patches.thickness[members] ** 2 + (arms @ normal) ** 2)
    thickness, width = np.sqrt(variance), np.sqrt(max(values[1], np.finfo(float).tiny))
    # The error of one patch is one error however many points it has: surfaces have waves.
    return normal, centre, float(thickness), float(thickness / (width * np.sqrt(len(weight))))
