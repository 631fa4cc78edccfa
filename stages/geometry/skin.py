"""Reconstructions that are a skin: how much their steps are blurred, and a model as they show it.

Dense matching and meshing drape a sheet over what stands there: gaps and what lies below anything
are closed, edges are rounded, thin parts lose their height. A drawing of the object has to be
draped likewise before it is compared; a model that was cut from such a scene is so already.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter, grey_closing
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import ObjectModel, Sampling
from spinpipe.stages.geometry.columns import column_order, extremes
from spinpipe.stages.geometry.model_surface import SURFACE_POINTS
from spinpipe.stages.geometry.shapes import Mesh, sample_surface, surface_area

REACH_SPACINGS = 4.0
"""Radius of the column around a place in which a step is looked for."""
STEEP = 1.5
"""Least height of a step, in such radii."""
PLACES, FEWEST_STEPS = 2_000, 20
FEWEST_POINTS = 8
ENDS = np.array([0.05, 0.95])
"""Quantiles of the heights in a column between which a step is."""
MIDDLE = 0.6745
"""Standard deviations from the middle of a blurred step to a quarter of its height."""
SHARP = 0.1
"""Quantile of the widths of steps: slopes and crowns are wide in any scene, some walls are in most.
Of clouds blurred by 1.2 spacings it is 1.0 (five artificial scenes)."""
BLURRED_SPACINGS = 0.5
"""From here on the steps are those of a skin: chosen. Ten artificial scenes of separate points have
0.02 to 0.03, two lidar scans 0.07 and 0.2, photos of a town 0.2, of a car park 0.9."""
CELLS_PER_BLUR = 6.0
"""Of the sheet that a drawing is draped with: wider ones make what is thin wider."""
POINTS_PER_CELL, MOST_POINTS = 4.0, 2_000_000
"""Of the drawing, that the sheet's height is taken from."""


def blur_of(points: F64, spacing_m: float) -> float:
    """Standard deviation of the blur of a cloud's sharpest steps, metres; 0 if it is no skin.

    Around places half way up a step the points between a quarter and three quarters of its height
    lie on a plane: how much that leans is the width of the step.

    Parameters
    ----------
    points : (N, 3) world, metres.
    spacing_m : between neighbours.
    """
    reach_m = REACH_SPACINGS * spacing_m
    places = _amid_steps(points, reach_m)
    places = places[:: max(1, -(-len(places) // PLACES))]
    around = KDTree(points[:, :2]).query_ball_point(places[:, :2], reach_m)
    widths = [
        _width(points[rows], place[2], reach_m) for rows, place in zip(around, places, strict=True)
    ]
    steps = [width for width in widths if width is not None]
    if len(steps) < FEWEST_STEPS:
        return 0.0
    blur_m = float(np.quantile(steps, SHARP))
    return blur_m if blur_m >= BLURRED_SPACINGS * spacing_m else 0.0


def _amid_steps(points: F64, reach_m: float) -> F64:
    """Points at middle height in columns of side ``reach_m`` that are higher than wide."""
    order, first = column_order(points, reach_m)[:2]
    ordered = points[order]
    counts = np.diff(np.append(first, len(ordered)))
    low, high = ordered[first, 2], ordered[first + counts - 1, 2]
    share = (ordered[:, 2] - np.repeat(low, counts)) / np.repeat(high - low, counts).clip(1e-9)
    return ordered[(np.repeat(high - low, counts) > reach_m) & (share > 0.3) & (share < 0.7)]


def _width(around: F64, z: float, reach_m: float) -> float | None:
    """Standard deviation of the blur of a step that a place at height z is the middle of."""
    # np.quantile takes ten times as long for so few
    low, high = np.interp(ENDS * (len(around) - 1), np.arange(len(around)), np.sort(around[:, 2]))
    step = high - low
    if step < STEEP * reach_m or abs(z - (low + high) / 2) > step / 10:
        return None
    plane = around[np.abs(around[:, 2] - z) <= step / 4]
    if len(plane) < FEWEST_POINTS:
        return None
    off = plane - plane.mean(axis=0)
    normal = np.linalg.eigh(off.T @ off)[1][:, 0]
    lean = abs(normal[2]) / max(float(np.hypot(normal[0], normal[1])), 1e-9)
    return float(lean * step / 2 / (2 * MIDDLE))


def shown(model: ObjectModel, sampling: Sampling) -> ObjectModel:
    """A model as the scene shows it: drawings are draped in a skin, all else comes as it is.

    Whoever asks gets the same points: they are about model and scene, not part of a run's chance.
    """
    if sampling.blur_m == 0.0 or len(model.faces) == 0:
        return model
    mesh = Mesh(model.vertices.astype(np.float64), model.faces.astype(np.int64))
    points, normals = draped(mesh, sampling.blur_m, SURFACE_POINTS, np.random.default_rng(0))
    return replace(
        model,
        points=points.astype(np.float32),
        normals=normals.astype(np.float32),
        vertices=model.vertices[:0],
        faces=model.faces[:0],
    )


def draped(mesh: Mesh, blur_m: float, count: int, rng: np.random.Generator) -> tuple[F64, F64]:
    """``count`` points and unit normals (N, 3) on the blurred sheet over a mesh and its ground.

    Parameters
    ----------
    mesh : z up, its base at the least z.
    blur_m : standard deviation of the blur.
    """
    low, high = extremes(mesh.vertices)
    area = surface_area(mesh)
    cell_m = max(blur_m / CELLS_PER_BLUR, float(np.sqrt(POINTS_PER_CELL * area / MOST_POINTS)))
    points = sample_surface(*mesh, round(POINTS_PER_CELL * area / cell_m**2), rng)[0]
    pad = 4.0 * blur_m + 2 * cell_m
    origin = low[:2] - pad
    shape = np.ceil((high[:2] + pad - origin) / cell_m).astype(int)
    height = np.zeros(shape)
    row = ((points[:, :2] - origin) / cell_m).astype(int)
    np.maximum.at(height, (row[:, 0], row[:, 1]), points[:, 2] - low[2])
    height = grey_closing(height, 3)  # cells that no point fell into
    height = gaussian_filter(height, blur_m / cell_m, mode="constant")
    x, y = (origin[k] + (np.arange(shape[k]) + 0.5) * cell_m for k in (0, 1))
    # beyond the object's extent the sheet is its neighbours' as well
    inside = (x > low[0]) & (x < high[0])
    height *= inside[:, None] & ((y > low[1]) & (y < high[1]))
    xyz = np.stack([*np.meshgrid(x, y, indexing="ij"), height + low[2]], axis=-1).reshape(-1, 3)
    at = (np.arange(shape[0] - 1)[:, None] * shape[1] + np.arange(shape[1] - 1)).ravel()
    across = at + shape[1]
    faces = [np.stack([at, across, at + 1], 1), np.stack([at + 1, across, across + 1], 1)]
    faces = np.concatenate(faces)
    sheet = (xyz[faces, 2] > low[2]).any(axis=1)
    return sample_surface(xyz, faces[sheet], count, rng)
