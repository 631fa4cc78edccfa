"""Points of a benchmark scene as photos from the ground or a drone or a smooth skin give them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.ndimage import gaussian_filter, grey_closing

from spinpipe.schemas.arrays import F64
from spinpipe.stages.geometry.frames import yaw_matrix
from spinpipe.stages.geometry.seen_from_above import FaceGrid, seen_from_above
from spinpipe.stages.geometry.shapes import (
    Mesh,
    merged,
    placed,
    sample_surface,
    surface_area,
)

View = Literal["all", "above", "skin"]

# Elevations of the rays, degrees: cameras all around, or a drone's nadir and oblique photos
_ELEVATIONS_DEG = {"all": (15.0, 45.0), "above": (55.0,)}
_AZIMUTHS = 8
SKIN_CELLS = 2
"""Cells of the skin's height field to a spacing."""
SKIN_SIGMA_SPACINGS = 1.2


@dataclass(frozen=True)
class Ground:
    """Level, or gently uneven."""

    amplitude_m: float
    wavelength_m: float

    def height(self, xy: F64) -> F64:
        """(N,) at (N, 2)."""
        wave = 2 * math.pi / self.wavelength_m
        return self.amplitude_m * (np.sin(wave * xy[:, 0]) + np.sin(1.3 * wave * xy[:, 1] + 1))


@dataclass(frozen=True)
class Thing:
    """One thing that stands in the scene.

    Attributes
    ----------
    kind : how an instance stands, ``decoy`` or ``clutter``.
    unseen : horizontal direction; no photo shows what faces it.
    roughness_m : standard deviation of the surface along its normal.
    """

    name: str
    kind: str
    mesh: Mesh
    position: tuple[float, float, float]
    heading_deg: float
    unseen: tuple[float, float] | None = None
    roughness_m: float = 0.0

    @property
    def sought(self) -> bool:
        """Whether it is an instance."""
        return self.kind not in ("decoy", "clutter")

    @property
    def standing(self) -> Mesh:
        """The mesh where it stands."""
        return placed(self.mesh, self.position, self.heading_deg)

    def on(self, ground: Ground) -> Thing:
        """The same on the ground at its middle."""
        x, y, z = self.position
        lift = float(ground.height(np.array([[x, y]]))[0])
        return replace(self, position=(x, y, z + lift))

    def rough(self, roughness_m: float) -> Thing:
        """The same with a rough surface."""
        return replace(self, roughness_m=roughness_m)

    def turned(self, rotation: F64) -> Thing:
        """The same in a scene turned by a small (3, 3) rotation."""
        angle = math.radians(self.heading_deg)
        front = rotation @ [math.cos(angle), math.sin(angle), 0.0]
        x, y, z = (rotation @ np.array(self.position)).tolist()
        heading = math.degrees(math.atan2(front[1], front[0])) % 360
        return replace(self, position=(x, y, z), heading_deg=heading)


def points_of(
    things: Sequence[Thing],
    ground: Ground,
    half_m: float,
    spacing_m: float,
    view: View,
    rng: np.random.Generator,
) -> F64:
    """(N, 3) points on what is seen, about ``spacing_m`` apart, in random order.

    Parameters
    ----------
    things, ground : what is there.
    half_m : half the side of the square that is reconstructed.
    """
    count = round((2 * half_m / spacing_m) ** 2)
    # a skin is dense matching: many pixels to a point that is kept
    sampled_m = spacing_m / (2 * SKIN_CELLS) if view == "skin" else spacing_m
    xy = rng.uniform(-half_m, half_m, (count, 2))
    points = [np.column_stack([xy, ground.height(xy)])]
    normals = [np.tile([0.0, 0.0, 1.0], (count, 1))]
    hidden = [np.zeros(count, bool)]
    for thing in things:
        mesh = thing.standing
        number = round(surface_area(mesh) / sampled_m**2)
        xyz, normal = sample_surface(*mesh, number, rng)
        seen_side = np.ones(number, bool)
        if thing.unseen is not None:
            seen_side = normal[:, :2] @ np.array(thing.unseen) < 0.3
        points.append(xyz)
        normals.append(normal)
        hidden.append(~seen_side)
    xyz, normal = np.concatenate(points), np.concatenate(normals)
    counts = [len(p) for p in points]
    roughness = np.repeat([0.0, *(t.roughness_m for t in things)], counts)
    open_side = ~np.concatenate(hidden) & (np.abs(xyz[:, :2]) < half_m).all(axis=1)
    open_side &= xyz[:, 2] > ground.height(xyz[:, :2]) - 1e-6
    facing = _facing(xyz, normal, merged([t.standing for t in things]), view)
    seen = open_side & (rng.random(len(xyz)) < (facing if view != "all" else np.sign(facing)))
    along = roughness[:, None] * rng.standard_normal((len(xyz), 1))
    xyz = (xyz + along * normal)[seen]
    if view == "skin":
        xyz = _skin(xyz, ground, half_m, spacing_m, rng)
    return xyz[rng.permutation(len(xyz))]


def _facing(xyz: F64, normal: F64, mesh: Mesh, view: View) -> F64:
    """(N,) largest cosine between the normal and a ray that reaches the point; 0: unseen."""
    best = np.zeros(len(xyz))
    elevations = _ELEVATIONS_DEG["above" if view == "skin" else view]
    rays = [(0.0, 90.0)]
    rays += [(360 * k / _AZIMUTHS, e) for e in elevations for k in range(_AZIMUTHS)]
    for azimuth, elevation in rays:
        # turned so that the sensor is straight above
        lean = math.radians(90 - elevation)
        level = np.array(
            [[math.cos(lean), 0, -math.sin(lean)], [0, 1, 0], [math.sin(lean), 0, math.cos(lean)]]
        )
        R = level @ yaw_matrix(-azimuth)[:3, :3]
        cosine = normal @ R[2]
        rows = np.flatnonzero(cosine > np.maximum(best, 0.05))
        seen = seen_from_above(xyz[rows] @ R.T, FaceGrid.of(Mesh(mesh.vertices @ R.T, mesh.faces)))
        best[rows[seen]] = cosine[rows[seen]]
    return best


def _skin(
    xyz: F64, ground: Ground, half_m: float, spacing_m: float, rng: np.random.Generator
) -> F64:
    """Points on the smoothed height field of a cloud: closed, gaps are bridged [as a DSM]."""
    cell = spacing_m / SKIN_CELLS
    count = int(2 * half_m / cell)
    axis = (np.arange(count) + 0.5) * cell - half_m
    x, y = (a.ravel() for a in np.meshgrid(axis, axis, indexing="ij"))
    height = ground.height(np.column_stack([x, y])).reshape(count, count)
    row = np.clip(((xyz[:, :2] + half_m) / cell).astype(int), 0, count - 1)
    np.maximum.at(height, (row[:, 0], row[:, 1]), xyz[:, 2])
    height = grey_closing(height, 3)  # cells that no sample fell into
    smooth = gaussian_filter(height, SKIN_SIGMA_SPACINGS * SKIN_CELLS, mode="nearest")
    a = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.concatenate(
        [np.stack([a, a + count, a + 1], 1), np.stack([a + 1, a + count, a + count + 1], 1)]
    )
    mesh = Mesh(np.column_stack([x, y, smooth.ravel()]), faces)
    return sample_surface(*mesh, round(surface_area(mesh) / spacing_m**2), rng)[0]
