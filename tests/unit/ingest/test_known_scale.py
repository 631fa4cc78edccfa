"""The scale of a scene by a known distance, and by the GPS that photos carry."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.poses import Cameras
from spinpipe.stages.ingest.ingest import Ingest
from spinpipe.stages.ingest.known_scale import ScaleFrom, earth_centred, gps_of, known_scale
from spinpipe.stages.stage import StageError

WHERE = Path("scene")
M_A_DEGREE = 111_320.0


def photo(path: Path, longitude: float, latitude: float, height: float) -> None:
    """A JPEG with GPS as cameras write it: degrees, minutes, seconds and a letter."""
    exif = Image.Exif()
    tags: dict[int, Any] = exif.get_ifd(0x8825)
    for tag, value, letters in ((2, latitude, "SN"), (4, longitude, "WE")):
        minutes = 60 * (abs(value) % 1)
        tags[tag - 1] = letters[int(value > 0)]
        tags[tag] = (float(int(abs(value))), float(int(minutes)), float(60 * (minutes % 1)))
    tags[5], tags[6] = bytes([int(height < 0)]), float(abs(height))
    path.parent.mkdir(exist_ok=True)
    Image.new("RGB", (8, 8)).save(path, exif=exif)


def flight(folder: Path, scale: float, noise_m: float, spread_m: float = 60.0) -> Cameras:
    """Cameras in units of ``scale`` metres, turned, and their photos over Buenos Aires."""
    rng = np.random.default_rng(0)
    east, north, up = rng.uniform(-1, 1, (3, 15)) * np.array([[spread_m], [spread_m], [8]])
    names = tuple(f"strip/{i:02}.jpg" for i in range(15))
    off = rng.normal(0, noise_m, (3, 15))
    off[:, 4] += 400  # one before it had a fix
    for i, name in enumerate(names):
        photo(
            folder / name,
            -58.4 + (east + off[0])[i] / (M_A_DEGREE * np.cos(np.radians(34.6))),
            -34.6 + (north + off[1])[i] / M_A_DEGREE,
            60 + (up + off[2])[i],
        )
    turn = Rotation.from_euler("xyz", [100, 20, 30], degrees=True)
    positions: F64 = turn.apply(np.stack([east, north, up], axis=1)) / scale + [5, 6, 7]
    return Cameras(positions, np.tile([0.0, 0, 0, 1], (15, 1)), names)


def test_a_known_distance() -> None:
    cameras = Cameras(np.diag([3.0, 4.0, 0.0]), np.zeros((3, 4)), ("a/x.jpg", "b/y.jpg", "a/z.jpg"))
    for rules in (
        ScaleFrom(points=((0, 0, 1), (0, 5, 1)), distance_m=2.0),
        ScaleFrom(cameras=("x.jpg", "b/y.jpg"), distance_m=2.0),
    ):
        scale, note = known_scale(rules, cameras, None, WHERE)
        assert scale == pytest.approx(0.4)
        assert note.startswith("0.4 m a unit: ")
        assert note.endswith("are 2 m apart")


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"points": ((1, 1, 1), (1, 1, 1)), "distance_m": 1}, "two points are in one place"),
        ({"cameras": ("a.jpg", "q.jpg"), "distance_m": 1}, "no camera 'q.jpg'; did you mean"),
        ({"cameras": ("a.jpg", "c.jpg"), "distance_m": 1}, "2 cameras are called 'c.jpg'"),
        ({"gps": True}, r"gps needs the folder: \[ingest\] photos"),
    ],
)
def test_what_cannot_tell_says_why(rules: dict[str, Any], message: str) -> None:
    cameras = Cameras(np.eye(3), np.zeros((3, 4)), ("a.jpg", "b/c.jpg", "c/c.jpg"))
    with pytest.raises(StageError, match=message):
        known_scale(ScaleFrom(**rules), cameras, None, WHERE)
    if "points" not in rules:
        with pytest.raises(StageError, match="the scene has none"):
            known_scale(ScaleFrom(**rules), None, None, WHERE)


@pytest.mark.parametrize(
    "section",
    [
        {"scale_from": {"points": ((0, 0, 0), (0, 0, 1))}},
        {"scale_from": {"distance_m": 3}},
        {"scale_from": {"distance_m": 3, "cameras": ("a", "b"), "gps": True}},
        {"scale": 2, "scale_from": {"gps": True}},
    ],
)
def test_half_or_twice_is_refused(section: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(ValidationError):
        Ingest.Config.model_validate({"scene": tmp_path, **section})


@pytest.mark.parametrize("scale", [0.07, 1.0, 30.0])
def test_gps_of_photos(scale: float, tmp_path: Path) -> None:
    cameras = flight(tmp_path, scale, noise_m=1.0)
    (tmp_path / cameras.names[9]).unlink()
    (tmp_path / cameras.names[10]).write_bytes(b"no picture")
    Image.new("RGB", (8, 8)).save(tmp_path / cameras.names[11])
    found, note = known_scale(ScaleFrom(gps=True), cameras, tmp_path, WHERE)
    assert found == pytest.approx(scale, rel=0.02)
    assert "GPS of 11 of 15 photos" in note
    assert "± 0." in note


def test_gps_that_is_too_inexact_is_refused(tmp_path: Path) -> None:
    cameras = flight(tmp_path, 1.0, noise_m=5.0, spread_m=6.0)
    with pytest.raises(StageError, match=r"uncertain by \d+%: the photos were taken too close"):
        known_scale(ScaleFrom(gps=True), cameras, tmp_path, WHERE)
    with pytest.raises(StageError, match="0 of 15 photos are there and have GPS, 4 are needed"):
        known_scale(ScaleFrom(gps=True), cameras, tmp_path / "strip", WHERE)


def test_gps_is_read_as_it_was_written(tmp_path: Path) -> None:
    photo(tmp_path / "a.jpg", -58.3816, -34.6037, -12.5)
    place = gps_of(tmp_path / "a.jpg")
    np.testing.assert_allclose(place, (-58.3816, -34.6037, -12.5), atol=1e-6)
    # [EPSG Guidance Note 7-2, 4.1.1]: the ends of the axes of the ellipsoid
    np.testing.assert_allclose(earth_centred([(0, 0, 0), (0, 90, 1)])[:, ::2],
                               [[6378137, 0], [0, 6356753.3142]], atol=1e-3)  # fmt: skip
