"""Skins: how blurred the steps of a cloud are, and drawings draped as such a cloud shows them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import erf

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import ObjectModel, Sampling
from spinpipe.stages.geometry.shapes import Mesh, box, merged, placed, sample_surface
from spinpipe.stages.geometry.skin import blur_of, draped, shown

SPACING_M = 0.1
CELL_M = 0.03


def boxes(blur_m: float) -> F64:
    """A yard of boxes as a blurred height field that is sampled evenly by its surface."""
    rng = np.random.default_rng(3)
    count = int(18 / CELL_M)
    axis = (np.arange(count) + 0.5) * CELL_M
    x, y = np.meshgrid(axis, axis, indexing="ij")
    height = np.zeros((count, count))
    for k in range(9):
        cx, cy, yaw = 3 + 6 * (k % 3), 3 + 6 * (k // 3), 0.2 * k
        u = (x - cx) * np.cos(yaw) + (y - cy) * np.sin(yaw)
        v = (y - cy) * np.cos(yaw) - (x - cx) * np.sin(yaw)
        height[(np.abs(u) < 1.5) & (np.abs(v) < 1.0)] = 1.5
    height = gaussian_filter(height, blur_m / CELL_M)
    at = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.concatenate([np.stack([at, at + count, at + 1], 1)])
    vertices = np.stack([x, y, height], axis=-1).reshape(-1, 3)
    _, second, third = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(second - vertices[faces[:, 0]], third - second), axis=1)
    number = round(float(area.sum()) / SPACING_M**2)
    points, _ = sample_surface(vertices, faces, number, rng)
    return points + rng.normal(0, 0.1 * SPACING_M, points.shape)


@pytest.mark.parametrize("spacings", [1.0, 1.5])
def test_the_blur_of_steps_is_measured(spacings: float) -> None:
    blur_m = blur_of(boxes(spacings * SPACING_M), SPACING_M)
    assert blur_m == pytest.approx(spacings * SPACING_M, rel=0.25)


def test_upright_walls_of_points_are_no_skin() -> None:
    assert blur_of(boxes(0.01 * SPACING_M), SPACING_M) == 0.0


def test_a_plain_and_a_slope_have_no_steps() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 20, (40_000, 2))
    assert blur_of(np.column_stack([xy, 0.01 * rng.random(len(xy))]), SPACING_M) == 0.0
    assert blur_of(np.column_stack([xy, 0.5 * xy[:, 0]]), SPACING_M) == 0.0


def test_a_plate_loses_the_height_that_a_blur_leaves_it() -> None:
    rng = np.random.default_rng(1)
    plate, blur_m = box(0.1, 3.0, 1.0), 0.1
    points, normals = draped(plate, blur_m, 60_000, rng)
    top = points[np.abs(points[:, 1]) < 1.0][:, 2].max()
    # the cells of the sheet make it a little thicker
    assert top == pytest.approx(erf(0.05 / blur_m / np.sqrt(2)), abs=0.07)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    assert (normals[:, 2] > -1e-9).all()


def test_a_draped_table_keeps_its_place_and_shows_nothing_below_its_top() -> None:
    rng = np.random.default_rng(2)
    legs = [placed(box(0.06, 0.06, 0.7), (x, y, 0)) for x in (-0.7, 0.7) for y in (-0.4, 0.4)]
    table = merged([placed(box(1.5, 0.9, 0.04), (0, 0, 0.7)), *legs])
    points, _ = draped(table, 0.04, 60_000, rng)
    assert np.ptp(points[:, :2], axis=0) == pytest.approx([1.5, 0.9], abs=0.05)
    assert points[:, :2].mean(axis=0) == pytest.approx([0, 0], abs=0.02)
    assert points[:, 2].min() == pytest.approx(0.0, abs=0.03)
    middle = (np.abs(points[:, 0]) < 0.6) & (np.abs(points[:, 1]) < 0.3)
    assert points[middle, 2].min() > 0.7


@pytest.mark.parametrize(("blur_m", "drawing"), [(0.0, True), (0.1, False)])
def test_what_is_no_drawing_or_in_no_skin_comes_as_it_is(blur_m: float, drawing: bool) -> None:
    model = model_of(box(2.0, 1.0, 1.0), drawing)
    assert shown(model, Sampling(0.1, 0.01, blur_m=blur_m)) is model


def test_a_drawing_in_a_skin_is_draped() -> None:
    model = shown(model_of(box(2.0, 1.0, 1.0), True), Sampling(0.1, 0.01, blur_m=0.1))
    assert len(model.faces) == 0
    edge = np.abs(np.abs(model.points[:, 1]) - 0.5) < 0.02
    assert 0.4 < model.points[edge & (np.abs(model.points[:, 0]) < 0.5), 2].max() < 0.65


def model_of(mesh: Mesh, drawing: bool) -> ObjectModel:
    """A mesh, or a cloud on it."""
    points, normals = sample_surface(*mesh, 20_000, np.random.default_rng(6))
    rows = slice(None) if drawing else slice(0)
    return ObjectModel(
        "box",
        points.astype(np.float32),
        normals.astype(np.float32),
        mesh.vertices[rows].astype(np.float32),
        mesh.faces[rows].astype(np.int32),
        np.eye(4),
        "all",
    )
