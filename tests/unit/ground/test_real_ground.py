"""Which way is up in real reconstructions, however they are turned."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.unit.ground.scenes import UP, angle_deg, ground_of, up_of

from spinpipe.stages.ingest.readers.open_scene import open_scene


def read_real(path, every=1):
    """Cloud, or one in so many of its points, and cameras of a real scene in a local frame."""
    source = open_scene(path)
    points = np.concatenate([xyz for xyz, _ in source.chunks(1_000_000)])[::every]
    origin = np.round(points.mean(axis=0))
    cameras = source.about.cameras
    if cameras is not None:
        cameras = replace(cameras, positions=cameras.positions - origin)
    return points - origin, cameras


@pytest.mark.parametrize("name", ["photo-west", "lot-north", "deck-west", "bus-yard"])
def test_real_drone_scenes_keep_their_z(shared_data, name):
    """Though a lot drains by 1.8 degrees and ramps hold more of a deck than its level parts."""
    points, _ = read_real(shared_data / name / "scene.ply", every=4)
    assert angle_deg(up_of(points), UP) < 1.8


@pytest.mark.parametrize("name", ["deck-west", "bus-yard"])
def test_real_drone_scenes_stand_upright_however_turned(shared_data, name):
    points, _ = read_real(shared_data / name / "scene.ply")
    turn = Rotation.from_euler("xyz", (100, 35, -60), degrees=True)
    assert angle_deg(up_of(turn.apply(points)), turn.apply(UP)) < 0.5


def test_a_real_nadir_flight_stands_upright(shared_data):
    points, cameras = read_real(shared_data / "brighton" / "colmap_sparse")
    plane, _ = ground_of(points, cameras)
    assert angle_deg(np.array(plane.normal), UP) < 1
    assert plane.up_source == "cameras"
    dense, _ = read_real(shared_data / "brighton" / "pmvs" / "scene_binary.ply")
    assert angle_deg(up_of(dense), UP) < 1


def test_a_hand_held_model_with_y_down(shared_data):
    points, cameras = read_real(shared_data / "formats" / "colmap_old_bin" / "sparse" / "0")
    plane, _ = ground_of(points, cameras)
    up = np.array(plane.normal)
    rotations = Rotation.from_quat(cameras.quaternions_xyzw).as_matrix()
    assert (-(rotations[:, :, 1] + rotations[:, :, 2]) @ up > 0.5).all()
