"""What must not matter does not: order, tiles, the choice of axes and units, far clutter."""

# laspy has no complete types
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import laspy
import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import HITS
from spinpipe.stages.geometry.frames import transform
from spinpipe.stages.geometry.shapes import box, merged, placed, sample_surface

if TYPE_CHECKING:
    from tests.conftest import Cli, Yard, YardRun

F64 = np.ndarray[Any, np.dtype[np.float64]]

NEAR_M, NEAR_DEG = 0.01, 0.2


def run(cli: Cli, yard: Yard, folder: Path, xyz: F64, *options: str) -> Path:
    """Run the yard's config over other points, and return the run's folder."""
    config = yard.write(folder, xyz, "\n[run]\nname = 'yard'\n")
    outcome = cli("run", config, "--rerun", "off", "-o", folder / "run", *options)
    assert outcome.code == 0, outcome.err
    return folder / "run"


def poses(detections: list[dict[str, Any]]) -> list[F64]:
    """T_scene_model of the accepted."""
    return [np.array(d["T_scene_model"]) for d in detections if d["fate"] == "accepted"]


def assert_same_poses(found: list[F64], expected: list[F64], near_m: float = NEAR_M) -> None:
    assert len(found) == len(expected)
    for T in expected:
        nearest = min(found, key=lambda other: float(np.linalg.norm(other[:3, 3] - T[:3, 3])))
        assert np.linalg.norm(nearest[:3, 3] - T[:3, 3]) < near_m
        scale = np.linalg.det(T[:3, :3])
        turned = Rotation.from_matrix(nearest[:3, :3].T @ T[:3, :3] / scale ** (2 / 3))
        assert np.degrees(turned.magnitude()) < NEAR_DEG


@pytest.fixture(scope="module")
def still(finished_yard: YardRun, yard: Yard) -> list[F64]:
    """Poses in the yard as it is."""
    found = poses(finished_yard.detections())
    assert len(found) == len(yard.cars)
    return found


@pytest.mark.parametrize("seed", range(1))
def test_the_order_of_points_changes_no_byte(
    cli: Cli, yard: Yard, finished_yard: YardRun, tmp_path: Path, seed: int
) -> None:
    shuffled = np.random.default_rng(seed).permutation(yard.xyz)
    output = run(cli, yard, tmp_path, shuffled)
    expected = (finished_yard.output / "detections.json").read_bytes()
    assert (output / "detections.json").read_bytes() == expected


@pytest.mark.parametrize("tile_points", [1024, 1_000_000])
def test_tiles_change_no_hit_and_no_detection(
    cli: Cli, yard: Yard, finished_yard: YardRun, tmp_path: Path, tile_points: int
) -> None:
    output = run(cli, yard, tmp_path, yard.xyz, "--set", f"ingest.tile_points={tile_points}")
    for found, expected in zip(
        RunReader(RunFolder(output))(HITS),
        RunReader(RunFolder(finished_yard.output))(HITS),
        strict=True,
    ):
        np.testing.assert_array_equal(found.points, expected.points)
        np.testing.assert_array_equal(found.correlation, expected.correlation)
    expected = (finished_yard.output / "detections.json").read_bytes()
    assert (output / "detections.json").read_bytes() == expected


@pytest.mark.parametrize("seed", range(1))
def test_far_clutter_changes_nothing(
    cli: Cli, yard: Yard, still: list[F64], tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    x, y = 40 * np.array([np.cos(2.0 * seed + 1), np.sin(2.0 * seed + 1)])
    shed = merged(
        [placed(box(3, 2, 2.4), (x, y, 0.0), 33.0), placed(box(5, 0.2, 1), (x, y + 4, 0.0), 10.0)]
    )
    clutter = np.concatenate(
        [
            sample_surface(*shed, 4000, rng)[0],
            rng.uniform(-4, 4, (4000, 3)) * [1, 1, 0] + [x, y, 0],
        ]
    )
    output = run(cli, yard, tmp_path, np.concatenate([yard.xyz, clutter]))
    found = [T for T in poses(read(output)) if np.linalg.norm(T[:2, 3]) < 20]
    assert_same_poses(found, still)


def test_georeferenced_coordinates_lose_less_than_a_tenth_of_a_millimetre(
    cli: Cli, yard: Yard, still: list[F64], tmp_path: Path
) -> None:
    """From the file to the poses, and to the points of the labelled cloud."""
    corner = np.array([412_345.0, 5_312_345.0, 321.0])  # UTM
    xyz = yard.xyz + corner
    output = run(cli, yard, tmp_path, xyz)
    for found, expected in zip(poses(read(output)), still, strict=True):
        np.testing.assert_allclose(found[:3, 3], expected[:3, 3] + corner, rtol=0, atol=1e-4)
    outcome = cli("export", output, "--format", "las", "-o", tmp_path / "labelled.las")
    assert outcome.code == 0, outcome.err
    written = np.asarray(laspy.read(tmp_path / "labelled.las").xyz)
    off = KDTree(written - corner).query(yard.xyz)[0]
    assert off.max() < np.sqrt(3) * 1e-4


@pytest.mark.parametrize("seed", range(2))
def test_detections_move_with_the_scene(
    cli: Cli, yard: Yard, still: list[F64], tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    T_moved_scene = np.eye(4)
    tilt = Rotation.from_rotvec(np.radians(15) * rng.uniform(-1, 1, 3) * [1, 1, 0])
    turn = Rotation.from_euler("z", rng.uniform(0, 360), degrees=True)
    T_moved_scene[:3, :3] = (tilt * turn).as_matrix()
    T_moved_scene[:3, 3] = rng.uniform(-1, 1, 3) * [5e5, 4e6, 100]
    output = run(cli, yard, tmp_path, transform(T_moved_scene, yard.xyz))
    assert_same_poses(poses(read(output)), [T_moved_scene @ T for T in still])


def test_detections_are_in_the_units_of_the_scene(
    cli: Cli, yard: Yard, still: list[F64], tmp_path: Path
) -> None:
    foot = 0.3048
    feet = np.diag([1 / foot, 1 / foot, 1 / foot, 1.0])
    output = run(cli, yard, tmp_path, yard.xyz / foot, "--set", f"ingest.scale={foot}")
    assert_same_poses(poses(read(output)), [feet @ T for T in still], NEAR_M / foot)


def read(output: Path) -> list[dict[str, Any]]:
    """All detections of a run."""
    return json.loads((output / "detections.json").read_text())["detections"]
