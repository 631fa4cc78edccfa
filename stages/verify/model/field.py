"""A model prepared for registration: surface samples, nearest-sample grid, body and visibility.

The grid answers "which surface sample is nearest to this point" with one look-up, so that a
registration step needs no search tree [Fitzgibbon 2003, Robust registration of 2D and 3D point
sets, section 4].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F32, F64, I32, Mask
from spinpipe.stages.geometry.model_surface import top_of
from spinpipe.stages.verify.model.sight import (
    hull_edges,
    open_air,
    outline_points,
    reached,
    turned_outward,
)

NEXT_TO_NOTHING = 0.1
"""Share of a surface that does not tell one heading from another."""


class ModelField(NamedTuple):
    """A rigid model in its object frame, ready to be looked up, by kernels too.

    Attributes
    ----------
    samples : (S, 3) float64, surface samples, evenly spread, metres.
    surface : (S, 8) float64, samples and outward unit normals in one row: one look at memory gives
        both.
    outermost_m : horizontal distance of the outermost sample from the base centre.
    probes, probe_normals : (V, 3) float64, an even choice of the samples that are visible from
        above.
    seen_weight : (V,) float64, share of the visible area, as projected, that each stands for.
    sides, side_normals : (W, 3) float64, an even choice of the samples on upright surfaces.
    size : (3,) float64, extent of the bounding box; its base centre is the origin.
    top, top_half : (2,) float64, middle and half extents of the top, on which a spin image's origin
        may be; top_level is its height.
    origin, voxel_m : corner and pitch of the grid.
    resolution_m : distance below which the field tells no two surfaces apart.
    nearest : (nx, ny, nz) int32, index of the sample nearest to each voxel's centre.
    clearance : (nx, ny, nz) float32, square metres: no point of a voxel is nearer than its root to
        any sample; negative in voxels wholly inside the bounding box.
    footprint : (nx, ny) bool, columns whose ground the body hides from above.
    edges : (E, 4) float64, edges of the convex hull of the footprint: a point on each, (x, y), and
        its outward unit normal.
    depth_edge : (nx, ny) int32, the edge that each column is nearest to from inside.
    depths : (nx * ny,) float64, ascending, how far inside the outline the columns' middles lie.
    outline : (P, 2) float64, points along the convex hull of the footprint, evenly spaced.
    outline_normals : (P, 2) float64, unit, outward.
    outline_height : (P,) float64, how high the model is just inside each of them, metres.
    """

    samples: F64
    surface: F64
    outermost_m: float
    probes: F64
    probe_normals: F64
    seen_weight: F64
    sides: F64
    side_normals: F64
    size: F64
    top: F64
    top_half: F64
    top_level: float
    origin: F64
    voxel_m: float
    resolution_m: float
    nearest: I32
    clearance: F32
    footprint: Mask
    edges: F64
    depth_edge: I32
    depths: F64
    outline: F64
    outline_normals: F64
    outline_height: F64

    @property
    def normals(self) -> F64:
        """(S, 3) of the samples."""
        return self.surface[:, 3:6]

    @property
    def narrow_m(self) -> float:
        """Half of the narrower horizontal extent."""
        return float(min(self.size[0], self.size[1]) / 2)

    @property
    def reach_m(self) -> float:
        """Half of the horizontal diagonal: no part is farther from the base centre."""
        return float(np.hypot(self.size[0], self.size[1]) / 2)

    def glanced(self, share: int) -> ModelField:
        """The same with one in ``share`` of its probes, in arrays of the same kind.

        Strided ones would be compiled for once more.
        """
        names = ("probes", "probe_normals", "seen_weight", "sides", "side_normals")
        fewer = {name: getattr(self, name)[::share].copy() for name in names}
        fewer["seen_weight"] /= fewer["seen_weight"].sum()
        return self._replace(**fewer)

    def distances(self, points: F64) -> F64:
        """(N,) from points (N, 3) of the object frame to the nearest samples, inf off the grid."""
        cell = np.floor((points - self.origin) / self.voxel_m).astype(int)
        on = np.all((cell >= 0) & (cell < np.array(self.nearest.shape)), axis=1)
        near = self.samples[self.nearest[*cell[on].T]]
        distances = np.full(len(points), np.inf)
        distances[on] = np.linalg.norm(points[on] - near, axis=1)
        return distances

    def looks_same(self, turn: float, shift: F64, error_m: float, spacing_m: float) -> bool:
        """Whether turned by ``turn`` radians and moved by (3,) it can hardly be told from itself.

        The mean distance from the turned surface to the surface [ADD-S: Hinterstoisser et al.
        2012] is compared with the error of surfaces and the resolution of the model; or next to
        nothing of it lies farther away than the points are apart: the foot of a cone.
        """
        cos, sin = np.cos(turn), np.sin(turn)
        probe = self.samples[:: max(1, len(self.samples) // 1000)]
        turned = probe @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + shift
        distance = self.distances(turned)
        if np.isinf(distance).any():
            return False
        if distance.mean() < max(self.resolution_m, error_m):
            return True
        other = distance > max(2 * self.resolution_m, spacing_m)
        return bool(other.mean() < NEXT_TO_NOTHING)


def build_model_field(
    name: str,
    points: NDArray[np.floating],
    normals: NDArray[np.floating],
    resolution: int = 64,
    spread: int = 8000,
    probes: int = 400,
) -> ModelField:
    """Prepare a model from points on its surface.

    Parameters
    ----------
    name : the model's name.
    points : (N, 3), dense points on the surface in the object frame, metres, of even density.
    normals : (N, 3), unit normals; their signs are corrected where the air is on one side only.
    resolution : voxels along the longest side of the bounding box.
    spread : about how many samples to keep; they are spread evenly over the surface.
    probes : about how many samples to probe the visible surface with.

    Raises
    ------
    ValueError
        If there are fewer than 50 points or the model has no height or width.
    """
    points = np.asarray(points, dtype=np.float64)
    normals = np.asarray(normals, dtype=np.float64)
    if len(points) < 50:
        raise ValueError(f"model {name!r}: {len(points)} points are too few, 50 are the least")
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    if size[2] <= 0 or max(size[0], size[1]) <= 0:
        raise ValueError(f"model {name!r} is flat: {size} m")
    points = points - [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]
    kept = _spread_evenly(points, spread)
    tree = KDTree(points[kept], leafsize=32)  # for every voxel: a third faster than with 10
    spacing = float(np.median(tree.query(points[kept], k=2)[0][:, 1]))
    voxel = max(float(size.max()) / resolution, spacing / 2)
    margin = max(0.35 * float(np.median(size)), 4 * voxel)
    origin = np.array([-size[0] / 2 - margin, -size[1] / 2 - margin, -margin])
    shape = np.ceil((size + 2 * margin) / voxel).astype(int)
    centres = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), -1)
    distance, nearest = tree.query(origin + (centres.reshape(-1, 3) + 0.5) * voxel)
    surface = np.zeros(shape, dtype=bool)
    cell = np.floor((points - origin) / voxel).astype(int)
    surface[cell[:, 0], cell[:, 1], cell[:, 2]] = True
    air, seen_steep = open_air(surface)
    samples, outward = points[kept], normals[kept]
    outward = turned_outward(samples, outward, air, origin, voxel)
    # the voxel of the sample itself: a step away may be the other side of a thin plate
    seen = reached(samples, seen_steep, origin, voxel)
    visible = np.flatnonzero(seen & (outward[:, 2] > 0.05))
    if len(visible) == 0:
        raise ValueError(f"model {name!r} has no surface that is visible from above")
    probe = visible[_spread_evenly(samples[visible], probes)]
    open_to_air = reached(samples + 1.5 * voxel * outward, air, origin, voxel)
    sides = np.flatnonzero(open_to_air & (np.abs(outward[:, 2]) < 0.5))
    # a probe stands for the visible samples nearest to it
    owner = KDTree(samples[probe]).query(samples[visible])[1]
    weight = np.bincount(owner, weights=outward[visible, 2], minlength=len(probe))
    edges = hull_edges(samples[:, :2])
    flat = centres[:, :, 0, :2]
    middle = origin[:2] + (flat + 0.5) * voxel
    depth = ((edges[:, :2] - middle[:, :, None]) * edges[:, 2:]).sum(axis=-1)
    depth_edge = depth.argmin(axis=-1).astype(np.int32)
    base = int(np.floor((0.05 * size[2] - origin[2]) / voxel))
    outline, outline_normals = outline_points(samples[:, :2], spacing=float(size[:2].min()) / 8)
    near = KDTree(samples[:, :2]).query_ball_point(outline, r=float(size[:2].min()) / 2)
    side = sides[_spread_evenly(samples[sides], probes)]
    level = samples[top_of(samples)]
    top = level[:, :2]
    return ModelField(
        samples=samples,
        surface=np.column_stack([samples, outward, np.zeros((len(samples), 2))]),
        outermost_m=math.sqrt((samples[:, 0] ** 2 + samples[:, 1] ** 2).max()),
        probes=samples[probe],
        probe_normals=outward[probe],
        seen_weight=weight / weight.sum(),
        sides=samples[side],
        side_normals=outward[side],
        size=size,
        top=(top.min(axis=0) + top.max(axis=0)) / 2,
        top_half=np.ptp(top, axis=0) / 2,
        top_level=float(np.median(level[:, 2])),
        origin=origin,
        voxel_m=voxel,
        resolution_m=float(0.6 * np.hypot(spacing, voxel)),
        nearest=nearest.reshape(shape).astype(np.int32),
        clearance=_clearance(distance.reshape(shape), size, origin, voxel),
        footprint=~air[:, :, base] | surface[:, :, base],
        edges=edges,
        depth_edge=depth_edge,
        depths=_depths(edges[depth_edge], origin, voxel),
        outline=outline,
        outline_normals=outline_normals,
        outline_height=np.array([samples[k, 2].max() for k in near]),
    )


def _depths(edge: F64, origin: F64, voxel: float) -> F64:
    """How far the middles of columns lie inside the edge (nx, ny, 4) that each is nearest to."""
    nx, ny, _ = edge.shape
    x = origin[0] + (np.arange(nx)[:, None] + 0.5) * voxel
    y = origin[1] + (np.arange(ny) + 0.5) * voxel
    px, py, normal_x, normal_y = np.moveaxis(edge, -1, 0)
    return np.sort((normal_x * (px - x) + normal_y * (py - y)).ravel())


def _clearance(
    distance: F64,
    size: F64,
    origin: F64,
    voxel: float,
) -> F32:
    """See ``ModelField``, given the (nx, ny, nz) distances of the voxels' centres."""
    rounding = 1e-3 * voxel
    least = np.clip(distance - math.sqrt(3) / 2 * voxel - rounding, 0.0, None)
    low = [o + np.arange(n) * voxel for o, n in zip(origin, distance.shape, strict=True)]
    first = -size[0] / 2, -size[1] / 2, 0.0
    last = size[0] / 2, size[1] / 2, size[2]
    x, y, z = (
        (edge > a + rounding) & (edge + voxel < b - rounding)
        for edge, a, b in zip(low, first, last, strict=True)
    )
    within = x[:, None, None] & y[:, None] & z
    return np.where(within, -(least**2), least**2).astype(np.float32)


def _spread_evenly(points: F64, count: int) -> NDArray[np.intp]:
    """One point per cell of a grid so fine that about ``count`` cells are occupied."""
    if len(points) <= count:
        return np.arange(len(points))
    low, fine, coarse = points.min(axis=0), 0.0, float(np.ptp(points, axis=0).max())
    first = np.arange(len(points))
    for _ in range(20):
        pitch = (fine + coarse) / 2
        cell = np.floor((points - low) / pitch).astype(np.int64)
        key = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
        first = np.unique(key, return_index=True)[1]
        if abs(len(first) - count) < 0.02 * count:
            break
        fine, coarse = (pitch, coarse) if len(first) > count else (fine, pitch)
    return np.sort(first)
