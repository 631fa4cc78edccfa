"""Objects planted into a scene take on its density, noise and gaps."""

import numpy as np
import pytest

from spinpipe.pipeline.scenes.free_places import Footprint, Place
from spinpipe.pipeline.scenes.ground_grid import ground_grid
from spinpipe.pipeline.scenes.planting import look_around, plant, visible_surface
from spinpipe.schemas.records import ObjectModel
from spinpipe.stages.geometry.frames import transform
from spinpipe.stages.geometry.shapes import box, sample_surface

CRATE = box(4.0, 2.0, 1.5)


def crate(visible_from, as_cloud=False):
    vertices, faces = CRATE
    points, normals = sample_surface(vertices, faces, 20_000, np.random.default_rng(0))
    if as_cloud:
        vertices, faces, normals = np.empty((0, 3)), np.empty((0, 3)), np.zeros_like(points)
    return ObjectModel(
        name="crate",
        points=points.astype(np.float32),
        normals=normals.astype(np.float32),
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.int32),
        T_object_model=np.eye(4),
        visible_from=visible_from,
    )


def meadow(noise_m=0.03, density=150, tilt=0.05):
    rng = np.random.default_rng(1)
    xy = rng.uniform(0, 20, (400 * density, 2))
    z = tilt * xy[:, 0] + noise_m * rng.standard_normal(len(xy))
    return np.column_stack([xy, z])


def ground_of(points):
    return ground_grid(
        [points], np.zeros(2), np.full(2, 20.0), cell_m=0.25, window_m=8.0, step_m=0.4
    )


def planted(points, visible_from="all", place=None, seed=0):
    place = place or Place(10.0, 10.0, 30.0, Footprint(4.0, 2.0, 1.5))
    grid = ground_of(points)
    around = look_around(points, grid, place, 0.25)
    rng = np.random.default_rng(seed)
    surface = visible_surface(crate(visible_from), around.density, rng)
    return plant(surface, place, around, points, grid, rng)


def test_surroundings_are_measured():
    points = meadow()
    place = Place(10.0, 10.0, 0.0, Footprint(4.0, 2.0, 1.5))
    around = look_around(points, ground_of(points), place, 0.25)
    assert around.density == pytest.approx(150, rel=0.1)
    assert around.noise_m == pytest.approx(0.03, rel=0.1)
    assert around.base_z == pytest.approx(0.5, abs=0.01)


def test_no_ground_no_measure():
    points = meadow()
    bare = points[np.abs(points[:, 0] - 10) > 3]
    place = Place(10.0, 10.0, 0.0, Footprint(4.0, 2.0, 1.5))
    with pytest.raises(ValueError, match="ground"):
        look_around(bare, ground_of(bare), place, 0.25)


def test_planted_object_has_density_and_noise_of_the_ground():
    crop = planted(meadow())
    area = 2 * (4 * 1.5 + 2 * 1.5) + 4 * 2  # the underside does not show
    assert len(crop.points) == pytest.approx(150 * area, rel=0.1)
    assert crop.visibility == 1.0
    in_object = transform(np.linalg.inv(crop.T_world_object), crop.points)
    top = in_object[(np.abs(in_object[:, :2]) < [1.8, 0.8]).all(axis=1) & (in_object[:, 2] > 1.2)]
    assert top[:, 2].std() == pytest.approx(0.03, rel=0.2)
    assert top[:, 2].mean() == pytest.approx(1.5, abs=0.01)


def test_from_above_walls_hardly_show():
    crop = planted(meadow(), "above")
    in_object = transform(np.linalg.inv(crop.T_world_object), crop.points)
    on_roof = in_object[:, 2] > 1.3
    assert on_roof.sum() == pytest.approx(150 * 8, rel=0.12)
    assert (~on_roof).sum() < 0.3 * len(on_roof)


def test_what_hangs_over_it_hides_it_only_from_above():
    points = meadow(tilt=0.0)
    roof = points[points[:, 0] > 10] + [0, 0, 4.0]
    scene = np.concatenate([points, roof])
    place = Place(10.0, 10.0, 0.0, Footprint(4.0, 2.0, 1.5))
    half = planted(scene, "above", place)
    assert half.visibility == pytest.approx(0.5, abs=0.1)
    assert half.points[:, 0].max() < 10.4
    assert planted(scene, "all", place).visibility == 1.0


def test_border_of_the_scene_cuts_it():
    points = meadow(tilt=0.0)
    points = points[points[:, 0] < 10]
    crop = planted(points, place=Place(9.5, 10.0, 0.0, Footprint(4.0, 2.0, 1.5)))
    assert crop.points[:, 0].max() < 10.4
    assert 0.5 < crop.visibility < 0.75


def test_it_hides_the_ground_below_it_and_nothing_else():
    points = meadow()
    crop = planted(points)
    hidden = crop.hides(points)
    in_object = transform(np.linalg.inv(crop.T_world_object), points)
    below = (np.abs(in_object[:, :2]) < [2.0, 1.0]).all(axis=1)
    far = (np.abs(in_object[:, :2]) > [2.3, 1.3]).any(axis=1)
    assert hidden[below].mean() > 0.99
    assert not hidden[far].any()
    assert not crop.hides(points + [0, 0, 3.0]).any()


def test_clouds_have_areas_too():
    mesh = visible_surface(crate("all"), 150, np.random.default_rng(0))
    cloud = visible_surface(crate("all", as_cloud=True), 150, np.random.default_rng(0))
    assert cloud.area_m2.sum() == pytest.approx(mesh.area_m2.sum() + 8, rel=0.1)


def test_same_seed_same_points():
    points = meadow()
    np.testing.assert_array_equal(planted(points, seed=3).points, planted(points, seed=3).points)
    assert len(planted(points, seed=3).points) != len(planted(points, seed=4).points)
