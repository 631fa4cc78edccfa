"""The artificial scene: the same bytes always, and a truth that is true."""

from __future__ import annotations

import hashlib
import itertools
import math
import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray

from spinpipe.pipeline.scenes.artificial import ArtificialScene, TruthRow, make_scene
from spinpipe.stages.geometry.frames import transform, yaw_matrix
from spinpipe.stages.geometry.model_surface import topmost_point
from spinpipe.stages.geometry.shapes import Mesh, covered_from_above
from spinpipe.stages.scan.image import SpinGrid, correlation, spin_image

TENTED = 4


def digest(scene: ArtificialScene) -> str:
    arrays = [scene.xyz, scene.rgb, scene.labels]
    for model in scene.models.values():
        arrays += [model.vertices, model.faces, model.cloud]
    data = b"".join(array.tobytes() for array in arrays) + repr(scene.truth).encode()
    return hashlib.sha256(data).hexdigest()


def on_car(scene: ArtificialScene, row: TruthRow) -> NDArray[np.float64]:
    """Points of one car in its frame ``object``."""
    moved = scene.xyz[scene.labels == row.label] - np.array([row.x, row.y, row.z])
    return transform(yaw_matrix(-row.heading_deg), moved)


@pytest.fixture(scope="module")
def scene() -> ArtificialScene:
    return make_scene()


def test_same_bytes_in_every_call_and_process():
    scene = make_scene(20_000)
    assert digest(make_scene(20_000)) == digest(scene)
    code = (
        "import runpy, sys; names = runpy.run_path(sys.argv[1]);"
        "print(names['digest'](names['make_scene'](20_000)))"
    )
    other = subprocess.run(
        [sys.executable, "-c", code, __file__], capture_output=True, text=True, check=True
    )
    assert other.stdout.strip() == digest(scene)


def test_counts_and_types(scene: ArtificialScene):
    assert scene.xyz.shape == (250_000, 3)
    assert scene.rgb.shape == (250_000, 3)
    assert scene.rgb.dtype == np.uint8
    assert scene.labels.dtype == np.int32
    np.testing.assert_array_equal(scene.xyz, scene.xyz.astype(np.float32))
    assert [row.model for row in scene.truth] == ["model_1"] * 4 + ["model_2"] * 4
    assert [row.label for row in scene.truth] == list(range(1, 9))
    for model in scene.models.values():
        assert model.cloud.shape == (25_000, 3)


@pytest.mark.parametrize("points", [1, 1000])
def test_any_number_of_points(points: int):
    small = make_scene(points, rng=np.random.default_rng(1))
    assert len(small.xyz) == len(small.rgb) == len(small.labels) == points


def test_bad_parameters_are_refused():
    for points, noise_m in [(0, 0.0), (10, -1.0), (10, math.nan)]:
        with pytest.raises(ValueError, match="points >= 1 and noise_m >= 0"):
            make_scene(points, noise_m)


def test_models_stand_on_their_base_centre(scene: ArtificialScene):
    for model in scene.models.values():
        low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
        np.testing.assert_allclose((low + high)[:2] / 2, 0, atol=1e-6)
        assert low[2] == 0
        assert 3.6 < high[0] - low[0] < 5
        assert 1.6 < high[1] - low[1] < 2
        assert 1.3 < high[2] < 1.7


def test_truth_lies_on_the_cars(scene: ArtificialScene):
    for row in scene.truth:
        points = on_car(scene, row)
        model = scene.models[row.model]
        assert len(points) > 1500
        low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
        assert (points >= low - 1e-3).all()
        assert (points <= high + 1e-3).all()
        np.testing.assert_allclose(points.min(axis=0), low, atol=0.1)
        np.testing.assert_allclose(points.max(axis=0), high, atol=0.1)
        # The bonnet is lower than the tail, so the heading is not off by half a turn
        nose, tail = points[points[:, 0] > 1.6], points[points[:, 0] < -1.6]
        assert nose[:, 2].max() < tail[:, 2].max() - 0.05


def test_cars_keep_apart_and_no_ground_shows_under_them(scene: ArtificialScene):
    for a, b in itertools.combinations(scene.truth, 2):
        assert math.hypot(a.x - b.x, a.y - b.y) >= 6
    for row in scene.truth:
        reach = np.hypot(scene.xyz[:, 0] - row.x, scene.xyz[:, 1] - row.y)
        assert not ((reach < 0.7) & (scene.labels == 0)).any()
        others = ~np.isin(scene.labels, (0, row.label)) & (reach < 2.5) & (scene.xyz[:, 2] < 1.7)
        assert not others.any()


def test_the_tent_stands_over_the_fourth_car_only(scene: ArtificialScene):
    roofed: list[bool] = []
    for row in scene.truth:
        near = np.hypot(scene.xyz[:, 0] - row.x, scene.xyz[:, 1] - row.y) < 0.7
        above = near & (scene.labels != row.label)
        roofed.append(bool(above.any()) and float(scene.xyz[above, 2].min()) > 1.7)
    assert roofed == [row.label == TENTED for row in scene.truth]


def test_noise_changes_neither_layout_nor_sampling(scene: ArtificialScene):
    noisy = make_scene(noise_m=0.1)
    assert noisy.truth == scene.truth
    np.testing.assert_array_equal(noisy.labels, scene.labels)
    assert (noisy.xyz - scene.xyz).std() == pytest.approx(0.1, rel=0.01)
    np.testing.assert_array_equal(noisy.models["model_1"].cloud, scene.models["model_1"].cloud)


def test_from_above_hides_walls_and_the_tented_car(scene: ArtificialScene):
    above = make_scene(seen_from="above")
    assert len(above.xyz) == len(scene.xyz)
    assert above.truth == scene.truth
    assert (above.labels == TENTED).sum() == 0
    for row in above.truth:
        if row.label != TENTED:
            points, model = on_car(above, row), scene.models[row.model]
            assert len(points) > 1500
            assert not covered_from_above(
                points, Mesh(model.vertices, model.faces), clearance_m=0.01
            ).any()


@pytest.mark.parametrize(("bin_m", "wrong_is_hit"), [(0.1, False), (0.2, True)])
def test_coarse_bins_confuse_the_models_and_fine_ones_do_not(
    scene: ArtificialScene, bin_m: float, wrong_is_hit: bool
):
    """[Bovenkamp 2010, section 3.1]: rho 0.1 finds the right four, rho 0.2 all eight."""
    grid = SpinGrid.of(radius_m=2.5, height_m=1.0, bin_m=bin_m)
    templates = {
        name: spin_image(model.cloud - topmost_point(model.cloud), np.zeros(3), grid)
        for name, model in scene.models.items()
    }
    for row in scene.truth:
        car = scene.xyz[scene.labels == row.label]
        tops = car[np.argsort(car[:, 2])[-120:]]
        images = [spin_image(car, top, grid) for top in tops]
        for name, template in templates.items():
            best = max(correlation(image, template) for image in images)
            if name == row.model:
                assert best > 0.8
            else:
                assert (best > 0.6) == wrong_is_hit
