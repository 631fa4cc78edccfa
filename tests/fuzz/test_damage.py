"""Every reader: cut anywhere, numbers that are none, too few points; one line, an exit code."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from spinpipe.pipeline.errors import INPUT_ERROR, describe
from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.ingest.survey import left_out, survey

if TYPE_CHECKING:
    from tests.conftest import Cli

READERS = (
    *("ply", "ply-text", "ply-mesh", "las", "laz", "colmap-points", "colmap-images"),
    *("colmap-text", "pcd-text", "pcd", "text", "obj", "stl", "off", "glb", "gltf", "dae"),
    *("log", "ros-log", "e57", "bundler", "patch", "opensfm"),
)
CUTS = (0.0, 0.02, 0.1, 0.3, 0.6, 0.9, 0.99)


@pytest.fixture
def seeds(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    import seeds

    return seeds


@pytest.mark.parametrize("name", READERS)
def test_a_file_cut_anywhere(seeds: Any, tmp_path: Path, name: str) -> None:
    file, write, read = seeds.FORMATS[name]
    path = tmp_path / file
    write(path)
    read(path)
    whole = path.read_bytes()
    for share in CUTS:
        path.write_bytes(whole[: int(share * len(whole))])
        try:
            read(path)  # text and meshes may be whole without their end
        except Exception as error:
            text, code = describe(error)
            assert code == INPUT_ERROR, (share, text)
            assert "\n" not in text


@pytest.mark.parametrize("name", ["ply", "ply-text", "pcd", "text"])
@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.full((60, 3), np.nan), "finite"),
        (np.full((60, 3), np.inf), "finite"),
        (np.ones((60, 3)), "distinct points"),
        (np.ones((1, 3)), "distinct points"),
    ],
)
def test_points_that_make_no_scene(
    seeds: Any, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    name: str, points: Any, message: str,
) -> None:  # fmt: skip
    if name == "pcd" and len(points) < 60:
        pytest.skip("its header says 60")
    monkeypatch.setattr(seeds, "POINTS", points)
    file, write, _ = seeds.FORMATS[name]
    write(tmp_path / file)
    if name == "text":
        np.savetxt(tmp_path / file, points, fmt="%.4f")
    outcome = cli("inspect", tmp_path / file)
    assert outcome.code == INPUT_ERROR
    assert message in outcome.err
    assert outcome.err.count("\n") == 1


@pytest.mark.parametrize(
    "name",
    ["ply", "ply-text", "pcd", "pcd-text", "text", "colmap-points", "colmap-text", "log", "ros-log"]
    + ["bundler", "patch", "opensfm"],
)
def test_odd_points_among_others_are_counted(
    seeds: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    points = np.random.default_rng(0).uniform(-5, 5, (60, 3))
    points[0], points[1], points[2] = np.nan, np.inf, 1e38
    monkeypatch.setattr(seeds, "POINTS", points)
    file, write, _ = seeds.FORMATS[name]
    write(tmp_path / file)
    source = open_scene(tmp_path if file.startswith("points3D") else tmp_path / file)
    found = survey(source, file, 1000, Uncounted())
    sweeps = source.points // len(points)
    assert (found.points, found.dropped, found.strays) == (58 * sweeps, 2 * sweeps, sweeps)
    assert [line.split()[2] for line in left_out(found)] == [f"{2 * sweeps}", f"{sweeps}"]


class Uncounted:
    """A counter that nobody looks at."""

    def advance(self, steps: int = 1) -> None:
        """Count nothing."""
