"""COLMAP's models: points, lenses, what is georegistered, and damage."""

# laspy, pycolmap and trimesh have no complete types
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spinpipe.schemas.poses import Calibration
from spinpipe.stages.ingest.readers.lens import MODELS, calibration
from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.stage import StageError


def test_colmap_agrees_with_colmap(shared_data: Path, tmp_path: Path) -> None:
    import pycolmap

    for name in ("brighton/colmap_sparse", "formats/colmap_old_bin/sparse/0"):
        folder = shared_data / name
        theirs: Any = pycolmap.Reconstruction(folder)
        text = tmp_path / name
        text.mkdir(parents=True)
        theirs.write_text(text)
        for path in (folder, text):
            source = open_scene(path)
            xyz = np.concatenate([xyz for xyz, _ in source.chunks(1000)])
            rows = {tuple(np.round(p.xyz, 6)): tuple(p.color) for p in theirs.points3D.values()}
            assert set(map(tuple, np.round(xyz, 6).tolist())) == set(rows)
            cameras = source.about.cameras
            assert cameras is not None
            images = [theirs.images[key] for key in sorted(theirs.images)]
            poses = [image.cam_from_world().inverse() for image in images]
            assert cameras.names == tuple(image.name for image in images)
            np.testing.assert_allclose(cameras.positions, [p.translation for p in poses], atol=1e-9)
            turned = np.abs(
                np.sum(cameras.quaternions_xyzw * [p.rotation.quat for p in poses], axis=1)
            )
            np.testing.assert_allclose(turned, 1, atol=1e-12)
            for lens, image in zip(source.about.calibrations, images, strict=True):
                assert (lens.camera, lens.width) == (image.name, image.camera.width)
                np.testing.assert_allclose(
                    lens.K + [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]],
                    image.camera.calibration_matrix(),
                )


@pytest.mark.parametrize(("key", "model"), MODELS.items())
def test_every_lens_of_colmap_projects_as_in_colmap(key: int, model: tuple[str, int]) -> None:
    import pycolmap

    name, count = model
    size = (640, 480)
    camera: Any = pycolmap.Camera.create_from_model_name(1, name, 500.0, *size)
    assert (int(camera.model), len(camera.params)) == (key, count)
    focal = len(camera.focal_length_idxs())
    params = np.full(count, 0.01)
    params[: focal + 2] = [500, 510, 320, 240][2 - focal :]
    if focal:
        camera.params = params
    ours = calibration("a.jpg", name, size, params.tolist())
    if not focal:
        assert not ours.K.any()
        return
    np.testing.assert_allclose(
        ours.K + [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]], camera.calibration_matrix()
    )
    if ours.distortion_model == name:  # none of OpenCV's: kept as it is
        assert tuple(params[focal + 2 :]) == ours.D
        return
    ray = np.array([0.2, -0.1, 1.0])
    seen = camera.img_from_cam(ray)
    np.testing.assert_allclose(_projected(ours, ray) + 0.5, seen, atol=1e-6)


def _projected(camera: Calibration, ray: np.ndarray) -> np.ndarray:
    """Pixel of a ray [OpenCV 4.11: calib3d, fisheye]; as COLMAP sees it for models of its own."""
    u, v = ray[:2] / ray[2]
    r2 = u * u + v * v
    match camera.distortion_model:
        case "plumb_bob" | "rational_polynomial":
            k1, k2, p1, p2, k3, *more = camera.D
            k4, k5, k6 = more or (0, 0, 0)
            radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (
                1 + k4 * r2 + k5 * r2**2 + k6 * r2**3
            )
            x = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
            y = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
        case "kannala_brandt":
            theta = np.arctan(np.sqrt(r2))
            powers = theta ** np.arange(2, 9, 2)
            x, y = np.array([u, v]) * theta * (1 + powers @ camera.D) / np.sqrt(r2)
        case _:
            raise AssertionError
    return (camera.K @ [x, y, 1])[:2]


def test_a_colmap_model_that_hangs_colmap(shared_cases: Path) -> None:
    with pytest.raises(StageError, match=r"cannot read the COLMAP model|cut short"):
        list(open_scene(shared_cases / "hostile" / "hang_colmapbin").chunks(100))


def test_fused_cloud_beside_the_model_is_preferred(tmp_path: Path, shared_data: Path) -> None:
    import shutil

    sparse = tmp_path / "dense" / "sparse"
    shutil.copytree(shared_data / "formats" / "colmap_old_bin" / "dense" / "sparse", sparse)
    assert open_scene(sparse).points == 699
    fused = shared_data / "formats" / "colmap_fused_vis" / "fused.ply"
    shutil.copy(fused, tmp_path / "dense" / "fused.ply")
    for folder in (tmp_path, tmp_path / "dense", sparse):
        source = open_scene(folder)
        assert source.points == 924
        assert source.about.cameras is not None
        assert len(source.about.cameras.positions) == 7


@pytest.mark.parametrize(
    ("place", "name"),
    [
        ((0, 0, 0), ""),
        ((500_000, 5_400_000, 300), "georegistered, metres of a map"),
        ((4_180_000, 860_000, 4_720_000), "georegistered, earth-centred metres"),
    ],
)
def test_a_georegistered_colmap_model_is_said_to_be_one(
    tmp_path: Path, place: tuple[float, float, float], name: str
) -> None:
    x, y, z = place
    (tmp_path / "points3D.txt").write_text(
        "".join(f"{i} {x + i} {y} {z} 9 8 7 0.5\n" for i in range(5))
    )
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 64 48 50 50 32 24\n")
    (tmp_path / "images.txt").write_text(
        "".join(f"{i} 1 0 0 0 {-x - i} {-y} {-z} 1 {i}.jpg\n\n" for i in range(1, 4))
    )
    said = open_scene(tmp_path).about.coordinates
    assert (said.name, said.metres) == (name, (1.0, 1.0, 1.0) if name else None)
    assert said.geocentric == ("earth" in name)


@pytest.mark.parametrize(
    "pose", ["0 0 0 0 0 0 0", "1e200 0 0 0 0 0 0", "nan 0 0 0 0 0 0", "1 0 0 0 inf 0 0"]
)
def test_a_pose_that_is_none_is_told(tmp_path: Path, pose: str) -> None:
    (tmp_path / "points3D.txt").write_text("1 0 0 0 9 8 7 0.5\n")
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 64 48 50 50 32 24\n")
    (tmp_path / "images.txt").write_text(f"1 {pose} 1 a.jpg\n\n")
    with pytest.raises(StageError, match=r"images.txt: .*(rotation|place)"):
        open_scene(tmp_path)
