"""The ingest stage through the pipeline's own context and files."""

# plyfile and pycolmap have no complete types
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plyfile import PlyData, PlyElement
from pydantic import ValidationError
from rich.console import Console
from tests.unit.ingest.test_known_scale import M_A_DEGREE, photo

from spinpipe.pipeline.context import RunContext, RunReader
from spinpipe.pipeline.engine import LocalEngine
from spinpipe.pipeline.mcap_file import StageFileWriter
from spinpipe.pipeline.progress import stage_progress
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import CALIBRATIONS, CAMERAS, CLOUD, SCENE, TILES
from spinpipe.stages.ingest.ingest import Ingest
from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.stage import StageError


def ingest(
    folder: Path, scene: Path, memory_bytes: int = 1 << 30, **options: Any
) -> tuple[RunReader, list[str]]:
    """Run the stage; a reader of what it wrote, and its notes."""
    config = Ingest.Config.model_validate({"scene": scene, **options})
    folder.mkdir(parents=True, exist_ok=True)
    run_folder = RunFolder(folder)
    writer = StageFileWriter(run_folder.mcap("ingest"), {})
    with stage_progress(Console(quiet=True), "ingest") as progress:
        context = RunContext(
            stage=Ingest(),
            config=config,
            seed=0,
            key="",
            folder=run_folder,
            writer=writer,
            engine=LocalEngine(1),
            memory_bytes=memory_bytes,
            scratch=folder,
            progress=progress,
        )
        try:
            Ingest().run(context)
        except BaseException:
            writer.abandon()
            raise
    writer.close({})
    return RunReader(run_folder), context.notes


def write_scene(path: Path, xyz: Any, rgb: Any = None, **options: Any) -> Path:
    colours = [] if rgb is None else [("red", "u1"), ("green", "u1"), ("blue", "u1")]
    rows = np.empty(len(xyz), [(axis, "f8") for axis in "xyz"] + colours)
    for i, axis in enumerate("xyz"):
        rows[axis] = np.asarray(xyz)[:, i]
    for i, (name, _) in enumerate(colours):
        rows[name] = np.asarray(rgb)[:, i]
    PlyData([PlyElement.describe(rows, "vertex")], **options).write(str(path))
    return path


def georeferenced(count: int, seed: int = 0) -> tuple[Any, Any]:
    rng = np.random.default_rng(seed)
    xyz = rng.uniform(0, (60, 40, 3), (count, 3)) + (576_715.25, 5_188_162.75, 160)
    return xyz, rng.integers(0, 256, (count, 3)).astype(np.uint8)


def test_tiles_frame_and_index(tmp_path: Path) -> None:
    xyz, rgb = georeferenced(5000)
    scene = write_scene(tmp_path / "scene.ply", xyz, rgb)
    read, notes = ingest(tmp_path / "run", scene, tile_points=1024, scale=0.5)
    assert not [note for note in notes if "left out" in note or "repeat" in note]
    (frame,), (index,) = read(SCENE), read(TILES)
    tiles = list(read(CLOUD))
    assert (frame.points, frame.dropped, frame.coloured) == (5000, 0, True)
    assert (frame.scale, frame.source) == ((0.5, 0.5, 0.5), "scene.ply")
    assert frame.origin == tuple(np.rint(frame.origin))

    assert len(tiles) == len(index.counts) > 4
    for i, tile in enumerate(tiles):
        assert len(tile.xyz) == len(tile.rgb) == index.counts[i] <= 1024
        np.testing.assert_array_equal(tile.xyz.min(axis=0), index.low[i])
        np.testing.assert_array_equal(tile.xyz.max(axis=0), index.high[i])

    # Back in the scene, every point is where it was to a tenth of a millimetre
    local = np.concatenate([tile.xyz for tile in tiles]).astype(np.float64)
    found = local / frame.scale + frame.origin
    order, expected = np.lexsort(found.round(2).T), np.lexsort(xyz.round(2).T)
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(xyz, axis=0), atol=1e-4)
    colours = np.concatenate([tile.rgb for tile in tiles])
    agree = (colours[order] == rgb[expected]).all(axis=1).mean()
    assert agree > 0.95  # rounding may swap points that differ in one coordinate by a hair

    assert len(read(CAMERAS)) == 0


def test_order_encoding_and_memory_do_not_matter(tmp_path: Path) -> None:
    xyz, rgb = georeferenced(6000)
    shuffled = np.random.default_rng(1).permutation(6000)
    variants: list[tuple[Any, int, dict[str, Any]]] = [
        (np.arange(6000), 1 << 30, {"byte_order": "<"}),
        (shuffled, 1 << 30, {"byte_order": ">"}),
        (shuffled, 1 << 20, {"byte_order": "<"}),  # a sample for the cuts, several chunks
    ]
    written: list[list[bytes]] = []
    for i, (order, memory, options) in enumerate(variants):
        scene = write_scene(tmp_path / f"{i}.ply", xyz[order], rgb[order], **options)
        read, _ = ingest(tmp_path / f"run{i}", scene, memory, tile_points=1024)
        written.append([t.xyz.tobytes() + t.rgb.tobytes() for t in read(CLOUD)])
    assert written[0] == written[1]
    assert sum(map(len, written[2])) == sum(map(len, written[0]))


def test_points_without_finite_coordinates_are_left_out(tmp_path: Path) -> None:
    xyz, _ = georeferenced(500)
    xyz[3, 0], xyz[40, 1], xyz[499, 2], xyz[7] = np.nan, np.inf, -np.inf, 1e300
    read, notes = ingest(tmp_path / "run", write_scene(tmp_path / "scene.ply", xyz))
    (frame,) = read(SCENE)
    assert (frame.points, frame.dropped, frame.coloured) == (496, 4, False)
    assert "left out 4 points whose coordinates are not finite" in notes
    (tile,) = read(CLOUD)
    assert np.isfinite(tile.xyz).all()
    assert (tile.rgb == 255).all()


def test_far_outliers_cost_no_precision(tmp_path: Path) -> None:
    xyz, _ = georeferenced(5000)
    xyz[:50] *= -1000
    scene = write_scene(tmp_path / "scene.ply", xyz)
    read, _ = ingest(tmp_path / "run", scene, tile_points=1024)
    (frame,) = read(SCENE)
    assert np.abs(np.array(frame.origin) - xyz[50:].mean(axis=0)).max() < 5


@pytest.mark.parametrize("missing", [[0.0, 0.0, 0.0], [576_730.0, 5_188_180.0, -9999.0]])
def test_cells_without_data_decide_nothing(tmp_path: Path, missing: Any) -> None:
    """Many copies of one point are one, and a few per cent far off are astray."""
    xyz, _ = georeferenced(5000)
    astray = np.tile(missing, (1500, 1))
    if missing[2]:
        astray = astray[:300] + np.random.default_rng(0).uniform(0, (9, 9, 0), (300, 3))
    scene = write_scene(tmp_path / "scene.ply", np.concatenate([xyz, astray]))
    read, notes = ingest(tmp_path / "run", scene)
    (frame,) = read(SCENE)
    assert (frame.points, frame.strays) == (5000, len(astray))
    assert f"left out {len(astray):,} points far from all others" in " ".join(notes)
    size = read(TILES)[0].high.max(axis=0) - read(TILES)[0].low.min(axis=0)
    np.testing.assert_allclose(size, (60, 40, 3), atol=0.2)


@pytest.mark.parametrize(
    ("crs", "offset", "scale", "said"),
    [
        ("EPSG:3857", (780_000, 6_621_000, 0), 0.62934, "draws the ground there 1.58896 times"),
        ("EPSG:32632", (500_000, 5_200_000, 0), 1.0, ""),
        ("EPSG:2272", (500_000, 5_200_000, 0), 0.3048006, "outside the area of NAD83"),
    ],
)
def test_metres_of_web_maps_are_not_metres(
    tmp_path: Path, crs: str, offset: Any, scale: float, said: str
) -> None:
    xyz = np.random.default_rng(0).uniform(0, (60, 40, 3), (500, 3)) + offset
    scene = write_scene(tmp_path / "scene.ply", xyz, comments=[crs])
    read, notes = ingest(tmp_path / "run", scene)
    (frame,) = read(SCENE)
    assert frame.scale[:2] == pytest.approx((scale, scale), rel=1e-5)
    assert said in " ".join(notes)
    assert said or len(notes) == 1
    _, notes = ingest(tmp_path / "stated", scene, scale=1.0)
    assert "times" not in " ".join(notes)


def test_duplicates_and_single_points(tmp_path: Path) -> None:
    xyz = np.full((3000, 3), 7.25)
    xyz[0] = 0
    scene = write_scene(tmp_path / "scene.ply", xyz)
    read, _ = ingest(tmp_path / "run", scene, tile_points=1024)
    assert sum(read(TILES)[0].counts) == 2
    (frame,) = read(SCENE)
    assert (frame.points, frame.duplicates) == (2, 2998)


@pytest.mark.parametrize(
    ("xyz", "message"),
    [
        (np.empty((0, 3)), "the cloud is empty"),
        (np.full((10, 3), np.nan), "none of its 10 points has finite coordinates"),
        (
            np.arange(30).reshape(10, 3) * 1e30,
            "its coordinates reach 2.9e.31, which no length does",
        ),
    ],
)
def test_bad_scenes(tmp_path: Path, xyz: Any, message: str) -> None:
    scene = write_scene(tmp_path / "scene.ply", xyz)
    with pytest.raises(StageError, match=message) as caught:
        ingest(tmp_path / "run", scene)
    assert "\n" not in str(caught.value)


def test_config_bounds(tmp_path: Path) -> None:
    cases: list[tuple[dict[str, Any], str]] = [
        ({"scale": 0.0}, "greater than"),
        ({"tile_points": 10}, "greater than or equal to 1024"),
        ({"typo": 1}, "Extra inputs"),
    ]
    for changed, message in cases:
        with pytest.raises(ValidationError, match=message):
            Ingest.Config.model_validate({"scene": tmp_path, **changed})


def test_colmap_cameras_come_along(tmp_path: Path, shared_data: Path) -> None:
    scene = shared_data / "brighton" / "colmap_sparse"
    read, _ = ingest(tmp_path / "run", scene, scale=2.0)
    (cameras,), (frame,) = read(CAMERAS), read(SCENE)
    assert [c.camera for c in read(CALIBRATIONS)] == list(cameras.names)
    assert cameras.names[0].endswith(".JPG")
    assert frame.photos == ""
    assert frame.points + frame.duplicates == 6847
    assert cameras.positions.shape == (18, 3)
    assert cameras.quaternions_xyzw.shape == (18, 4)
    # 46 m above the ground at height 0
    heights = cameras.positions[:, 2] / 2 + frame.origin[2]
    np.testing.assert_allclose(heights, 46, atol=3)


def test_photos_are_found_beside_the_model(tmp_path: Path, shared_data: Path) -> None:
    sparse = tmp_path / "sparse" / "0"
    shutil.copytree(shared_data / "brighton" / "colmap_sparse", sparse)
    cameras = open_scene(sparse).about.cameras
    assert cameras is not None
    (tmp_path / "images").mkdir()
    assert open_scene(sparse).about.photos is None
    (tmp_path / "images" / cameras.names[0]).touch()
    assert open_scene(sparse).about.photos == tmp_path / "images"
    read, _ = ingest(tmp_path / "run", sparse, photos=tmp_path)
    assert read(SCENE)[0].photos == str(tmp_path), "what is stated goes before"


@pytest.mark.parametrize(
    ("metres", "said"),
    [(1.0, "a unit is a metre, as the photos say"), (0.3, r"odd: .* say 0\.29?3?\d+ m a unit")],
)
def test_photos_tell_whether_a_model_is_in_metres(
    tmp_path: Path, shared_data: Path, metres: float, said: str
) -> None:
    """Aligned to GPS or not, a model near zero looks alike."""
    sparse = shared_data / "brighton" / "colmap_sparse"
    cameras = open_scene(sparse).about.cameras
    assert cameras is not None
    east, north, up = cameras.positions.T * metres
    for i, name in enumerate(cameras.names):
        photo(tmp_path / name, 8 + east[i] / M_A_DEGREE, north[i] / M_A_DEGREE, 60 + up[i])
    _, notes = ingest(tmp_path / "run", sparse, photos=tmp_path)
    assert any(re.search(said, note) for note in notes), notes
    _, notes = ingest(tmp_path / "stated", sparse, photos=tmp_path, scale=1.0)
    assert not any("photos say" in note for note in notes)


def test_a_known_distance_gives_the_scale(tmp_path: Path, shared_data: Path) -> None:
    sparse = shared_data / "brighton" / "colmap_sparse"
    cameras = open_scene(sparse).about.cameras
    assert cameras is not None
    apart = float(np.linalg.norm(cameras.positions[0] - cameras.positions[7]))
    rules = {"cameras": (cameras.names[0], cameras.names[7]), "distance_m": 3 * apart}
    read, notes = ingest(tmp_path / "run", sparse, scale_from=rules)
    np.testing.assert_allclose(read(SCENE)[0].scale, 3, rtol=1e-9)
    assert any(note.startswith("3 m a unit: ") for note in notes)


@pytest.mark.parametrize("name", ["photo-west/scene.ply", "brighton/odm_model.laz"])
def test_real_scenes(tmp_path: Path, shared_data: Path, name: str) -> None:
    read, _ = ingest(tmp_path / "run", shared_data / name)
    (frame,), (index,) = read(SCENE), read(TILES)
    assert frame.dropped == 0
    assert frame.coloured
    assert frame.points == sum(index.counts)
    assert np.abs([index.low, index.high]).max() < 100


_MEASURED = """
import sys
from pathlib import Path
import numpy as np
from spinpipe.stages.ingest.tiling import POINT
from tests.unit.ingest.test_ingest import ingest

folder, count = Path(sys.argv[1]), int(sys.argv[2])
small = folder / "small.ply"
header = "ply\\nformat binary_little_endian 1.0\\nelement vertex {}\\n" + "".join(
    f"property {t} {n}\\n" for n, t in zip(
        ("x", "y", "z", "red", "green", "blue"), ["float"] * 3 + ["uchar"] * 3)
) + "end_header\\n"
rng = np.random.default_rng(0)

def write(path, count):
    with path.open("wb") as file:
        file.write(header.format(count).encode())
        for start in range(0, count, 100_000):
            rows = np.zeros(min(100_000, count - start), POINT)
            rows["xyz"] = rng.uniform(0, (60, 60, 3), (len(rows), 3))
            rows.tofile(file)
    return path

def peak_mb():
    # ru_maxrss would be that of the process that started this one, if it was larger
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if "VmHWM" in line).split()[1]) / 1024

ingest(folder / "a", write(folder / "small.ply", 20_000))
before = peak_mb()
ingest(folder / "b", write(folder / "large.ply", count), 100_000_000)
print(peak_mb() - before)
"""


def test_memory_does_not_grow_with_the_scene(tmp_path: Path) -> None:
    """3 million points take 45 MB on disk, 81 MB as arrays; within 100 MB the stage needs less."""
    command = [sys.executable, "-c", _MEASURED, str(tmp_path), "3000000"]
    done = subprocess.run(
        command, cwd=Path(__file__).parents[3], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 60
