"""The ground stage on scenes whose up is known: made ones, turned ones, real ones."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.spatial.transform import Rotation
from tests.unit.ground.scenes import (
    UP,
    Memory,
    angle_deg,
    box,
    car_park,
    ground_of,
    rectangle,
    up_of,
)

from spinpipe.schemas import SAMPLING, SCENE
from spinpipe.schemas.poses import Cameras, Trajectory
from spinpipe.stages.ground.area_sample import sample_by_area
from spinpipe.stages.ground.ground import Ground
from spinpipe.stages.stage import StageError


@given(seed=st.integers(0, 10_000), noise_m=st.sampled_from([0.0, 0.02, 0.1, 0.2]))
@settings(max_examples=6, deadline=None)
def test_any_orientation_and_noise(seed, noise_m):
    rng = np.random.default_rng(seed)
    scene = car_park(rng, cars=6, size=20.0)
    scene += rng.normal(0, noise_m, scene.shape)
    turn = Rotation.random(random_state=seed)
    try:
        plane, upright = ground_of(turn.apply(scene) + (3, -7, 11))
    except StageError:  # in much noise it may stop, never guess
        if noise_m < 0.1:
            raise
        return
    normal = np.array(plane.normal)
    assert angle_deg(normal, turn.apply(UP)) < (0.2 if noise_m < 0.1 else 0.8)
    assert plane.up_source == "points"
    world = (upright.T_world_local[:3, :3] @ (turn.apply(scene) + (3, -7, 11)).T).T
    world += upright.translation
    assert abs(np.median(world[: len(scene) // 2, 2])) < 0.02 + noise_m / 4
    assert upright.translation[:2] == (0.0, 0.0)


@pytest.mark.parametrize("seed", range(2))
def test_turning_the_input_turns_the_answer(seed):
    rng = np.random.default_rng(seed)
    scene = car_park(rng) + rng.normal(0, 0.03, 3)
    turn = Rotation.random(random_state=seed)
    assert angle_deg(up_of(turn.apply(scene)), turn.apply(up_of(scene))) < 0.05


def test_order_and_tiling_change_nothing():
    rng = np.random.default_rng(0)
    scene = car_park(rng).astype(np.float32)
    first = ground_of(scene, pieces=1)
    assert ground_of(rng.permutation(scene), pieces=5) == first
    assert ground_of(scene[::-1], pieces=2) == first


def test_density_does_not_outvote_area():
    rng = np.random.default_rng(1)
    wall = rectangle(rng, (-15, 15, 0), (30, 0, 0), (0, 0, 3), density=2000)
    assert angle_deg(up_of(np.concatenate([car_park(rng), wall])), UP) < 0.2


def test_far_outliers_change_little():
    rng = np.random.default_rng(2)
    scene = car_park(rng)
    stray = rng.normal(0, 3000, (200, 3))
    assert angle_deg(up_of(np.concatenate([scene, stray])), up_of(scene)) < 0.05


def test_a_roof_larger_than_the_ground_is_not_the_ground():
    rng = np.random.default_rng(3)
    yard = rectangle(rng, (-14, -12, 0), (28, 0, 0), (0, 24, 0))
    yard = yard[(abs(yard[:, 0]) > 10) | (abs(yard[:, 1]) > 8)]
    roof = rectangle(rng, (-10, -8, 6), (20, 0, 0), (0, 16, 9))  # sloped by 29 degrees
    walls = [
        rectangle(rng, (-10, -8, 0), (20, 0, 0), (0, 0, 6)),
        rectangle(rng, (-10, 8, 0), (20, 0, 0), (0, 0, 15)),
    ]
    cars = [box(rng, x, -11, 1.8, 2.5, 1.4) for x in (-12, -6, 0, 6, 10)]
    with contextlib.suppress(StageError):  # walls hold more than the yard: it need not be decided
        assert angle_deg(up_of(np.concatenate([yard, roof, *walls, *cars])), UP) < 0.2


def test_a_flat_roof_seen_from_above_does_not_turn_the_scene_over():
    rng = np.random.default_rng(4)
    scene = car_park(rng, cars=6, size=40.0)
    scene = scene[(abs(scene[:, 0]) > 13) | (abs(scene[:, 1]) > 13)]
    roof = rectangle(rng, (-13, -13, 7), (26, 0, 0), (0, 26, 0))
    chimneys = [box(rng, x, x, 1, 1, 1.5) + (0, 0, 7) for x in (-8, -2, 5)]
    assert angle_deg(up_of(np.concatenate([scene, roof, *chimneys])), UP) < 0.2


def test_facades_larger_than_the_ground():
    rng = np.random.default_rng(5)
    street = rectangle(rng, (0, 0, 0), (40, 0, 0), (0, 9, 0))
    facade = rectangle(rng, (0, 9, 0), (40, 0, 0), (0, 0, 14))
    things = [box(rng, x, 2, 4.2, 1.8, 1.4) for x in (3, 9, 15, 21, 27, 33)]
    posts = [box(rng, x, 6, 0.2, 0.2, 4) for x in (1, 8, 20, 38)]
    assert angle_deg(up_of(np.concatenate([street, facade, *things, *posts])), UP) < 0.2


def test_a_ditch_deeper_than_the_cars_does_not_turn_the_scene_over():
    scene = car_park(np.random.default_rng(16), cars=6, size=40.0)
    ditch = np.clip(1 - abs(scene[:, 1] - 10) / 3, 0, None)
    scene[:, 2] -= 2 * ditch * (scene[:, 2] == 0)
    with contextlib.suppress(StageError):  # it need not be decided
        assert angle_deg(up_of(scene), UP) < 0.2


def test_things_on_a_table_above_a_floor():
    rng = np.random.default_rng(17)
    floor = rectangle(rng, (-1, -1, 0), (3, 0, 0), (0, 2.5, 0), density=4000)
    top = rectangle(rng, (0, 0, 0.75), (1.2, 0, 0), (0, 0.8, 0), density=10_000)
    tins = [box(rng, x, y, 0.1, 0.1, 0.15, 10_000) for x in (0.1, 0.5, 0.9) for y in (0.1, 0.6)]
    scene = np.concatenate([floor, top, *(tin + (0, 0, 0.75) for tin in tins)])
    assert angle_deg(up_of(scene), UP) < 0.2


def test_an_empty_room_is_undecided():
    rng = np.random.default_rng(18)
    o, a, b, c = np.array([[0, 0, 0], [5, 0, 0], [0, 4, 0], [0, 0, 3]])
    faces = [(o, a, b), (o + c, a, b), (o, a, c), (o + b, a, c), (o, b, c), (o + a, b, c)]
    room = np.concatenate([rectangle(rng, *face, density=200) for face in faces])
    with pytest.raises(StageError, match="cannot tell which way is up"):
        ground_of(room)


def test_up_follows_the_scene_not_the_axes():
    scene = car_park(np.random.default_rng(6))
    assert angle_deg(up_of(scene * (1, -1, -1)), -UP) < 0.2


def test_hilly_ground():
    rng = np.random.default_rng(7)
    scene = car_park(rng, cars=12, size=60.0)
    scene[:, 2] += 1.5 * np.sin(scene[:, 0] / 12) * np.cos(scene[:, 1] / 9)
    # slopes of 9 degrees without a wall: within them
    assert angle_deg(up_of(scene), UP) < 9


@pytest.mark.parametrize("noise_m", [0.0, 0.05])
def test_a_bare_plane_is_undecided(noise_m):
    rng = np.random.default_rng(8)
    bare = rectangle(rng, (0, 0, 0), (30, 0, 0), (0, 30, 0))
    bare += rng.normal(0, noise_m, bare.shape)
    with pytest.raises(StageError, match=r"cannot tell which way is up.*set ground\.up = \["):
        ground_of(bare)


def test_a_symmetric_scene_is_undecided():
    rng = np.random.default_rng(9)
    scene = car_park(rng)
    with pytest.raises(StageError, match="cannot tell which way is up"):
        ground_of(np.concatenate([scene, scene * (1, 1, -1)]))


def nadir_cameras(height):
    x, y = np.meshgrid(np.linspace(0, 30, 4), np.linspace(0, 30, 4))
    positions = np.c_[x.ravel(), y.ravel(), np.full(16, height)]
    down = Rotation.from_euler("x", 180 if height > 0 else 0, degrees=True).as_quat()
    return Cameras(positions, np.tile(down, (16, 1)), tuple(map(str, range(16))))


@pytest.mark.parametrize("side", [1, -1])
def test_cameras_decide_where_points_cannot(side):
    rng = np.random.default_rng(10)
    bare = rectangle(rng, (0, 0, 0), (30, 0, 0), (0, 30, 0))
    plane, _ = ground_of(bare, nadir_cameras(20.0 * side))
    assert angle_deg(np.array(plane.normal), side * UP) < 0.01
    assert plane.up_source == "cameras"


def test_cameras_against_the_points_are_undecided():
    scene = car_park(np.random.default_rng(11)) + (15, 15, 0)
    with pytest.raises(StageError, match="cannot tell which way is up"):
        ground_of(scene, nadir_cameras(-20.0), min_margin=20)


def test_a_wall_alone_before_level_cameras_is_undecided():
    rng = np.random.default_rng(15)
    wall = rectangle(rng, (0, 0, 0), (20, 0, 0), (0, 0, 8))
    boards = [box(rng, x, 0, 2, 1, 1) + (0, -1, z) for x, z in ((2, 3), (9, 5), (15, 2))]
    headings = np.linspace(-40, 40, 9)
    level = Rotation.from_matrix([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    turned = Rotation.from_euler("z", headings[:, None], degrees=True) * level
    positions = np.c_[np.linspace(2, 18, 9), np.full(9, -10), np.full(9, 1.7)]
    names = tuple(map(str, range(len(positions))))
    with pytest.raises(StageError, match=r"0\.0000, 1\.0000\] and.*; set ground\.up"):
        ground_of(np.concatenate([wall, *boards]), Cameras(positions, turned.as_quat(), names))


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0.05, 2), (0, 0, -1)])
def test_a_stated_up_is_kept_and_the_level_is_found(up):
    rng = np.random.default_rng(12)
    scene = (car_park(rng) + rng.normal(0, 0.02, 3)) * (1, 1, np.sign(up[2])) + (0, 0, 4)
    plane, upright = ground_of(scene, up=up)
    np.testing.assert_allclose(plane.normal, np.array(up) / np.linalg.norm(up))
    assert plane.up_source == "config"
    assert upright.translation[2] == pytest.approx(-4 * np.sign(up[2]), abs=0.15)


def test_a_stated_up_passes_roofs_and_stray_points_over():
    rng = np.random.default_rng(13)
    scene = car_park(rng)
    roof = rectangle(rng, (-15, -15, 6), (30, 0, 0), (0, 20, 0))
    kept = scene[scene[:, 1] > 5]
    stray = rng.uniform((-15, -15, -9), (15, 15, 0), (30, 3))
    plane, _ = ground_of(np.concatenate([kept, roof, stray]), up=(0, 0, 1))
    assert plane.offset == pytest.approx(0, abs=0.05)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((1, 3)), "fewer than three distinct points"),
        (np.repeat(np.eye(3)[:2], 50, axis=0), "fewer than three distinct points"),
        (np.outer(np.linspace(0, 9, 500), [1, 2, 3]), "one line"),
        (np.random.default_rng(0).uniform(-5, 5, (20_000, 3)), "no plane|cannot tell"),
    ],
)
@pytest.mark.parametrize("up", ["auto", (0, 0, 1)])
def test_degenerate_scenes_get_one_clear_line(points, message, up):
    if up != "auto" and "plane" in message:
        pytest.skip("a stated up needs no plane")
    with pytest.raises(StageError, match=message) as error:
        ground_of(points, pieces=1, up=up)
    assert "\n" not in str(error.value)


def test_an_up_of_no_length_is_refused():
    with pytest.raises(ValidationError, match=r"must not be \[0, 0, 0\]"):
        Ground.Config(up=(0, 0, 0))


def test_the_sample_is_bounded_and_uniform_in_area():
    rng = np.random.default_rng(14)
    sparse = rectangle(rng, (0, 0, 0), (10, 0, 0), (0, 10, 0), density=200)
    dense = rectangle(rng, (10, 0, 0), (10, 0, 0), (0, 10, 0), density=5000)
    tiles = np.array_split(np.concatenate([sparse, dense]).astype(np.float32), 7)
    sample = sample_by_area(tiles, 20, 5000)
    assert len(sample.points) <= 5000
    assert sample.counts.sum() == len(sparse) + len(dense)
    left = np.count_nonzero(sample.points[:, 0] < 10)
    assert left / len(sample.points) == pytest.approx(0.5, abs=0.02)


def test_steps_of_the_coordinates_are_no_evidence():
    """Metres in a column of whole numbers make planes that hold more than the ground."""
    lot = car_park(np.random.default_rng(27))
    lot[:, 0] = np.rint(lot[:, 0])
    context = Memory([lot.astype(np.float32)], None, 0)
    (frame,) = context.messages[SCENE]
    context.messages[SCENE] = [replace(frame, spacing_m=0.1, step_m=1.0)]
    with pytest.raises(StageError, match=r"coordinates come in steps of 1 m, 10 times as far"):
        Ground().run(context)


def test_what_the_format_says_is_kept():
    """One scan line of an airborne LiDAR is a wall to the points; LAS says that z is height."""
    rng = np.random.default_rng(26)
    along = rng.uniform(0, 500, 999)
    line = np.c_[along, -0.2 * along + rng.normal(0, 0.03, 999), 4 * np.sin(along / 90)]
    plane, _ = ground_of(line, declared=(0.0, 0.0, 1.0))
    assert plane.normal == (0, 0, 1)
    assert plane.up_source == "file"
    with pytest.raises(StageError, match="cannot tell which way is up"):
        ground_of(line)


def tables(rng, noise_m, spacing_m=0.02):
    """A floor of 5 x 5 m with tables and cupboards on it."""
    density = spacing_m**-2
    parts = [rectangle(rng, (0, 0, 0), (5, 0, 0), (0, 5, 0), density)]
    for x, y in ((0.4, 0.4), (2, 0.5), (3.5, 1.5), (0.5, 2), (2, 3.5)):
        parts.append(rectangle(rng, (x, y, 0.74), (1.2, 0, 0), (0, 0.8, 0), density))
        feet = [(x + a, y + b) for a in (0, 1.15) for b in (0, 0.75)]
        parts += [box(rng, *foot, 0.05, 0.05, 0.74, density) for foot in feet]
    parts += [box(rng, x, y, 0.6, 0.5, 0.9, density) for x, y in ((0.3, 3.8), (4, 4), (4.2, 0.3))]
    scene = np.concatenate(parts)
    return scene + noise_m * rng.standard_normal(scene.shape)


@pytest.mark.parametrize("noise_m", [0.0, 0.04])
def test_furniture_at_any_noise(noise_m):
    turn = Rotation.random(random_state=4)
    scene = turn.apply(tables(np.random.default_rng(19), noise_m))
    assert angle_deg(up_of(scene), turn.apply(UP)) < 0.5


@pytest.mark.parametrize("noise_m", [0.3])
def test_noise_of_several_spacings(noise_m):
    """Three times as thick as the points are apart."""
    scene = car_park(np.random.default_rng(20), cars=10, size=40.0)
    scene += noise_m * np.random.default_rng(21).standard_normal(scene.shape)
    turn = Rotation.random(random_state=6)
    assert angle_deg(up_of(turn.apply(scene)), turn.apply(UP)) < 0.5


def test_bushes_are_no_second_ground():
    """Noise widens what counts as a plane; a layer through cars and bushes must stay none."""
    rng = np.random.default_rng(22)
    scene = car_park(rng, cars=10, size=30.0)
    bushes = rng.uniform((-15, -15, 0), (15, -5, 2.2), (9000, 3))
    scene = np.concatenate([scene, bushes])
    scene += 0.05 * rng.standard_normal(scene.shape)
    assert angle_deg(up_of(scene), UP) < 0.5


def test_exactly_level_ground_without_noise():
    scene = car_park(np.random.default_rng(23))
    plane, _ = ground_of(scene)
    assert np.count_nonzero(scene[:, 2] == 0) > 0.5 * len(scene)
    assert angle_deg(np.array(plane.normal), UP) < 1e-3
    assert abs(plane.offset) < 1e-3


@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.2])
def test_measured_sampling_is_that_of_the_scene(noise_m):
    rng = np.random.default_rng(24)
    scene = car_park(rng)
    scene += noise_m * rng.standard_normal(scene.shape)
    context = Memory(np.array_split(scene.astype(np.float32), 3))
    Ground().run(context)
    sampling = context.written[SAMPLING]
    assert sampling.spacing_m == pytest.approx(40**-0.5, rel=0.2)
    assert sampling.noise_m == pytest.approx(noise_m, rel=0.2, abs=1e-4)


def ramps(rng, tilt_deg):
    """A deck with two ramps larger than its level parts, a street below, walls between them."""
    parts = [
        rectangle(rng, (-30, -8, 0), (60, 0, 0), (0, 5, 0)),
        rectangle(rng, (-30, 3, 2.4), (60, 0, 0), (0, 3, 0)),
        rectangle(rng, (-45, -20, -9), (90, 0, 0), (0, 10, 0)),
    ]
    rise = 18 * np.tan(np.radians(tilt_deg))
    parts.append(rectangle(rng, (-30, -25, 0), (60, 0, 0), (0, 17, rise)))
    parts.append(rectangle(rng, (-30, 8, 2.4), (60, 0, 0), (0, 9, rise / 2)))
    for corner, along in (((-30, -8, -9), (60, 0, 0)), ((-30, -8, 0), (0, 14, 0))):
        parts.append(rectangle(rng, corner, along, (0, 0, 3.4)))
    for x in (-24, -12, 0, 12, 24):
        parts.append(box(rng, x, -7, 4.2, 1.8, 1.4))
        parts.append(box(rng, x, -18, 4.2, 1.8, 1.4) + (0, 0, -9))
    scene = np.concatenate(parts)
    return scene + rng.normal(0, 0.02, scene.shape)


@pytest.mark.parametrize("tilt_deg", [3.2, 30])
def test_up_does_not_follow_ramps(tilt_deg):
    turn = Rotation.random(random_state=int(tilt_deg))
    scene = turn.apply(ramps(np.random.default_rng(25), tilt_deg))
    assert angle_deg(up_of(scene), turn.apply(UP)) < 0.5


def test_a_lidar_decides_what_the_points_do_not() -> None:
    """Its z axis is up by convention; where the points clearly say otherwise, the run stops."""
    rng = np.random.default_rng(0)

    def path(z):
        turn = Rotation.align_vectors([z], [[0, 0, 1]])[0]
        return Trajectory(np.zeros((1, 3)), turn.as_quat()[None], np.zeros(1, np.int64))

    room = np.concatenate(
        [rectangle(rng, *face) for face in (
            ((0, 0, 0), (8, 0, 0), (0, 5, 0)), ((0, 0, 3), (8, 0, 0), (0, 5, 0)),
            ((0, 0, 0), (8, 0, 0), (0, 0, 3)), ((0, 5, 0), (8, 0, 0), (0, 0, 3)),
            ((0, 0, 0), (0, 5, 0), (0, 0, 3)), ((8, 0, 0), (0, 5, 0), (0, 0, 3)),
        )]
    )  # fmt: skip
    with pytest.raises(StageError, match="cannot tell which way is up"):
        ground_of(room)
    tilted = np.array([0.0, 0.02, 1.0])
    assert angle_deg(up_of(room, lidar=path(tilted)), tilted) < 1.2
    assert up_of(room, lidar=path([0, 0, -1]))[2] < -0.999
    lot = car_park(rng)
    assert angle_deg(up_of(lot, lidar=path([0.0, 0.1, 1.0])), UP) < 0.3, "the points know better"
    with pytest.raises(StageError, match="cannot tell which way is up"):
        ground_of(lot, lidar=path([1, 0, 0]))
