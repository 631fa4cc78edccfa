"""Triangle meshes built from code, and points sampled from them uniformly by area.

Every solid is upright and stands on its base: z up, the middle of the base at the origin, metres.
Faces run counter-clockwise seen from outside, so their normals point outwards.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spinpipe.schemas.arrays import F64, I64, Mask
from spinpipe.stages.geometry.frames import transform, yaw_matrix


class Mesh(NamedTuple):
    """A triangle mesh: ``vertices`` (V, 3) float64 in metres, ``faces`` (F, 3) int64 indices."""

    vertices: F64
    faces: I64


def sample_surface(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    count: int,
    rng: np.random.Generator,
) -> tuple[F64, F64]:
    """Draw points independently and uniformly by area from a triangle mesh.

    A face is drawn with probability proportional to its area, then a point in it by the
    square-root map of [Osada et al. 2002, Shape Distributions, eq. 1].

    Parameters
    ----------
    vertices : (V, 3) float
    faces : (F, 3) int
    count : int
        How many points; 0 is allowed.
    rng : numpy.random.Generator

    Returns
    -------
    points : (count, 3) float64, in the unit and frame of ``vertices``
    normals : (count, 3) float64
        Unit normals of the faces that the points lie on, by the faces' winding.

    Raises
    ------
    ValueError
        When the mesh has no face with an area.
    """
    draw = draw_on_faces(vertices, faces, count, rng)
    return draw.points, draw.normals


class SurfaceDraw(NamedTuple):
    """Points drawn from a mesh, and where on it they lie."""

    points: F64
    normals: F64
    face: I64
    """(count,) rows of ``faces``."""
    weights: F64
    """(count, 3) barycentric coordinates in them."""


def draw_on_faces(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    count: int,
    rng: np.random.Generator,
) -> SurfaceDraw:
    """``sample_surface``, and where on the mesh each point lies."""
    areas, unit_normals = face_areas_and_normals(vertices, faces)
    cumulative: F64 = np.cumsum(areas)
    if not len(cumulative) or not cumulative[-1] > 0:
        raise ValueError("the mesh has no face with an area: nothing to sample")
    draws = rng.random((count, 3))
    # Right of equals: faces without area are never drawn; the cap guards against rounding up
    picked = _places(cumulative, draws[:, 0] * cumulative[-1])
    picked = np.minimum(picked, np.flatnonzero(areas)[-1])
    root, along = np.sqrt(draws[:, 1:2]), draws[:, 2:3]
    a, b, c = (np.asarray(vertices, np.float64)[faces[picked, corner]] for corner in range(3))
    weights = np.hstack([1 - root, root * (1 - along), root * along])
    points = weights[:, :1] * a + weights[:, 1:2] * b + weights[:, 2:] * c
    return SurfaceDraw(points, unit_normals[picked], picked, weights)


def face_areas_and_normals(
    vertices: NDArray[np.floating], faces: NDArray[np.integer]
) -> tuple[F64, F64]:
    """Areas (F,) and unit normals (F, 3) of triangles; a face without area has normal 0."""
    a, b, c = (np.asarray(vertices, np.float64)[faces[:, corner]] for corner in range(3))
    crossed = np.cross(b - a, c - a)
    doubled = np.sqrt((crossed**2).sum(axis=1))
    normals = crossed / np.where(doubled > 0, doubled, 1.0)[:, None]
    return doubled / 2, normals


def covered_from_above(points: F64, mesh: Mesh, clearance_m: float = 1e-3) -> Mask:
    """Whether a face of the mesh lies straight above each point (N, 3), by ``clearance_m``."""
    covered = np.zeros(len(points), bool)
    order = np.argsort(points[:, 0], kind="stable")
    x, y, z = points[order].T
    _, normals = face_areas_and_normals(*mesh)
    corners = mesh.vertices[mesh.faces]
    begins = _places(x, corners[:, :, 0].min(axis=1), "left")
    ends = _places(x, corners[:, :, 0].max(axis=1))
    for (a, b, c), normal, begin, end in zip(corners, normals, begins, ends, strict=True):
        if abs(normal[2]) < 1e-6:  # upright faces cover nothing
            continue
        u, v = x[begin:end] - a[0], y[begin:end] - a[1]
        e, f = (b - a)[:2], (c - a)[:2]
        area = e[0] * f[1] - e[1] * f[0]
        along_e, along_f = (u * f[1] - v * f[0]) / area, (v * e[0] - u * e[1]) / area
        height = a[2] - (normal[0] * u + normal[1] * v) / normal[2]
        covered[order[begin:end]] |= (
            (along_e >= 0)
            & (along_f >= 0)
            & (along_e + along_f <= 1)
            & (height > z[begin:end] + clearance_m)
        )
    return covered


def surface_area(mesh: Mesh) -> float:
    """Area of all faces, in square metres."""
    return float(face_areas_and_normals(*mesh)[0].sum())


def placed(mesh: Mesh, position: ArrayLike, heading_deg: float = 0.0) -> Mesh:
    """Return the mesh turned about +z by ``heading_deg`` and then moved to ``position``."""
    return Mesh(transform(yaw_matrix(heading_deg, position), mesh.vertices), mesh.faces)


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh with the faces of all."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]),
    )


def without_underside(mesh: Mesh) -> Mesh:
    """Return the mesh without the faces that look down: what stands on the ground hides them."""
    _, normals = face_areas_and_normals(*mesh)
    return Mesh(mesh.vertices, mesh.faces[normals[:, 2] > -0.9])


def box(length: float, width: float, height: float) -> Mesh:
    """Box with ``length`` along x, ``width`` along y, ``height`` along z."""
    x, y = length / 2, width / 2
    return extruded([(-x, 0), (x, 0), (x, height), (-x, height)], 2 * y)


def cylinder(
    radius: float, height: float, sides: int = 16, top_radius: float | None = None
) -> Mesh:
    """Upright cylinder with caps; ``top_radius`` makes it a truncated cone, 0 a cone."""
    top = radius if top_radius is None else top_radius
    ring = _circle(sides)
    sections = [
        np.column_stack([ring * size, np.full(sides, level)])
        for size, level in ((radius, 0.0), (top, height))
    ]
    return lofted(sections)


def ellipsoid(radii: tuple[float, float, float], sides: int = 16, rings: int = 8) -> Mesh:
    """Ellipsoid with half axes ``radii`` that stands on its lowest point."""
    ring = _circle(sides)
    sections: list[F64] = []
    for step in range(rings + 1):
        angle = math.pi * step / rings
        size, level = math.sin(angle), 1 - math.cos(angle)
        flat = ring * size * np.array(radii[:2])
        sections.append(np.column_stack([flat, np.full(sides, radii[2] * level)]))
    return lofted(sections, capped=False)


def extruded(profile: ArrayLike, width: float) -> Mesh:
    """Prism: a simple polygon in the x-z plane, swept along y from -width/2 to width/2.

    Parameters
    ----------
    profile : (K, 2) float
        Corners (x, z) in order, in either sense of turning; may be concave.
    """
    corners = np.asarray(profile, np.float64)
    if _doubled_area(corners) < 0:
        corners = corners[::-1]
    count = len(corners)
    sides = [np.insert(corners, 1, y, axis=1) for y in (-width / 2, width / 2)]
    cap = triangulated(corners)
    # Turning left in (x, z) is counter-clockwise seen from -y, where the first cap lies
    walls = _band(np.arange(count), np.arange(count) + count)[:, ::-1]
    return Mesh(np.concatenate(sides), np.concatenate([cap, cap[:, ::-1] + count, walls]))


def lofted(sections: Sequence[NDArray[np.floating]], capped: bool = True) -> Mesh:
    """Skin over closed cross-sections of equally many corners, joined in order.

    Parameters
    ----------
    sections : sequence of (K, 3) float
        Corners that run counter-clockwise seen from the end that the sections lead to (for
        sections stacked upwards: seen from above).
    capped : bool
        Close both ends with a fan; the end sections must then be convex.
    """
    count = len(sections[0])
    faces = [
        _band(np.arange(count) + level * count, np.arange(count) + (level + 1) * count)
        for level in range(len(sections) - 1)
    ]
    if capped:
        steps = np.arange(1, count - 1)
        fan = np.column_stack([np.zeros_like(steps), steps, steps + 1])
        faces += [fan[:, ::-1], fan + (len(sections) - 1) * count]
    return Mesh(np.concatenate(sections).astype(np.float64), np.concatenate(faces))


def triangulated(corners: F64) -> I64:
    """Triangles (K - 2, 3) of a simple polygon (K, 2) that turns left, by ear clipping.

    Raises
    ------
    ValueError
        When no ear is left, as where the polygon crosses itself or turns right.
    """
    left = list(range(len(corners)))
    triangles: list[tuple[int, int, int]] = []
    while len(left) > 2:
        for position in range(len(left)):
            ear = left[position - 1], left[position], left[(position + 1) % len(left)]
            others = corners[[corner for corner in left if corner not in ear]]
            if _doubled_area(corners[list(ear)]) > 0 and not _inside(corners[list(ear)], others):
                triangles.append(ear)
                del left[position]
                break
        else:
            raise ValueError("the polygon has no ear left: it crosses itself or turns right")
    return np.array(triangles, np.int64)


def _places(
    ordered: F64,
    values: F64,
    side: Literal["left", "right"] = "right",
) -> NDArray[np.intp]:
    """Where in the ascending array each value belongs."""
    return np.asarray(np.searchsorted(ordered, values, side=side), np.intp)


def _inside(triangle: F64, points: F64) -> bool:
    """Whether any point lies in a triangle that turns left, its border included."""
    edges = np.roll(triangle, -1, axis=0) - triangle
    offsets = points[:, None] - triangle
    return bool((edges[:, 0] * offsets[..., 1] >= edges[:, 1] * offsets[..., 0]).all(axis=1).any())


def _doubled_area(corners: F64) -> float:
    following = np.roll(corners, -1, axis=0)
    return float((corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]).sum())


def _band(lower: I64, upper: I64) -> I64:
    """Two triangles for each side between two closed rings of indices."""
    lower_next, upper_next = np.roll(lower, -1), np.roll(upper, -1)
    return np.concatenate(
        [
            np.column_stack([lower, lower_next, upper_next]),
            np.column_stack([lower, upper_next, upper]),
        ]
    )


def _circle(sides: int) -> F64:
    angles = [2 * math.pi * step / sides for step in range(sides)]
    return np.array([(math.cos(angle), math.sin(angle)) for angle in angles])
