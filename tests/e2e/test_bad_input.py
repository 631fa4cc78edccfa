"""Bad input: one line, an exit code, nothing half-written."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.e2e.refusals import assert_nothing_half_written, assert_one_line

from spinpipe.stages import STAGES

if TYPE_CHECKING:
    from tests.conftest import Cli, Yard


def fail(cli: Cli, folder: Path, code: int, *said: str, complete: str = "") -> None:
    """Run the folder's config; it must fail as a user may expect and leave what is complete."""
    outcome = cli("run", "config.toml", "--rerun", "save", cwd=folder)
    assert_one_line(outcome, code, *said)
    assert_nothing_half_written(folder, complete)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_missing_scene(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path)
    (tmp_path / "scene.ply").unlink()
    fail(cli, tmp_path, 1, "scene.ply", "[ingest] scene")
    assert not (tmp_path / "recordings").exists()


def test_a_missing_model(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path)
    (tmp_path / "saloon.ply").unlink()
    fail(cli, tmp_path, 1, "saloon.ply")


@pytest.mark.parametrize("share", [0.02, 0.5, 0.9999])
def test_a_scene_cut_short(cli: Cli, yard: Yard, tmp_path: Path, share: float) -> None:
    yard.write(tmp_path)
    path = tmp_path / "scene.ply"
    os.truncate(path, int(share * path.stat().st_size))
    fail(cli, tmp_path, 1, "scene.ply")


def test_a_text_scene_cut_short(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path)
    header = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
    (tmp_path / "scene.ply").write_text(header + "property float z\nend_header\n1 2 3\n4 5\n")
    fail(cli, tmp_path, 1, "scene.ply")


def test_an_empty_file(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path)
    (tmp_path / "scene.ply").write_bytes(b"")
    fail(cli, tmp_path, 1, "scene.ply")


def test_an_empty_cloud(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path, np.empty((0, 3)))
    fail(cli, tmp_path, 1, "scene.ply", "empty")


def test_a_cloud_of_nan(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path, np.full((100, 3), np.nan))
    fail(cli, tmp_path, 1, "scene.ply", "finite")


def test_some_nan_are_left_out_and_said(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    xyz = np.concatenate([yard.xyz, np.full((7, 3), np.nan)])
    config = yard.write(tmp_path, xyz)
    outcome = cli("run", config, "--until", "ingest", "--rerun", "off", cwd=tmp_path)
    assert outcome.code == 0
    assert "left out 7 points" in outcome.out


def test_a_model_of_nan(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path)
    yard.write(tmp_path / "other", np.full((100, 3), np.nan))
    (tmp_path / "other" / "scene.ply").rename(tmp_path / "saloon.ply")
    fail(cli, tmp_path, 1, "saloon", "enough points", complete="01_ingest.mcap")


def test_a_colmap_folder_without_points(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    import pycolmap

    yard.write(tmp_path)
    edit(tmp_path / "config.toml", "scene.ply", "sparse")
    (tmp_path / "sparse").mkdir()
    fail(cli, tmp_path, 1, "sparse")
    pycolmap.Reconstruction().write(tmp_path / "sparse")
    fail(cli, tmp_path, 1, "sparse")


def test_a_scene_of_an_unknown_kind(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path)
    (tmp_path / "scene.xyz").write_bytes(bytes(range(256)) * 20)
    edit(tmp_path / "config.toml", "scene.ply", "scene.xyz")
    fail(cli, tmp_path, 1, "scene.xyz")


def test_an_unknown_key(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path)
    edit(tmp_path / "config.toml", "radius_m", "raduis_m")
    fail(cli, tmp_path, 2, "config.toml: [scan] has no key 'raduis_m'", "'radius_m'?")


def test_a_negative_radius(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path)
    edit(tmp_path / "config.toml", "radius_m = 2.5", "radius_m = -2.5")
    fail(cli, tmp_path, 2, "config.toml: [scan] radius_m = -2.5")


def test_a_model_larger_than_the_scene(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path, yard.xyz / 1000)
    fail(cli, tmp_path, 1, "model 'saloon'", "[ingest] scale", complete="01_ingest.mcap")


def test_broken_toml(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    yard.write(tmp_path, extra="\n[scan\n")
    fail(cli, tmp_path, 2, "config.toml: not valid TOML", "line")


def test_a_missing_config(cli: Cli, tmp_path: Path) -> None:
    fail(cli, tmp_path, 2, "config.toml", "spinpipe init")


def test_an_undecided_up(cli: Cli, tmp_path: Path, yard: Yard) -> None:
    rng = np.random.default_rng(0)
    yard.write(tmp_path, rng.uniform(-10, 10, (20_000, 3)) * [1, 1, 1e-6])
    fail_after_ingest = cli("run", "config.toml", "--rerun", "off", cwd=tmp_path)
    assert_one_line(fail_after_ingest, 1, "ground.up")
    assert len(re.findall(r"\[-?\d[^\]]*\]", fail_after_ingest.err)) >= 2, "names both candidates"


def test_an_output_that_is_a_file(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    config = yard.write(tmp_path)
    (tmp_path / "out").write_text("mine")
    outcome = cli("run", config, "-o", tmp_path / "out", cwd=tmp_path)
    assert_one_line(outcome, 1, str(tmp_path / "out"))
    outcome = cli("run", config, "-o", tmp_path / "out" / "below", cwd=tmp_path)
    assert_one_line(outcome, 1, str(tmp_path / "out"))
    assert (tmp_path / "out").read_text() == "mine"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_an_output_that_may_not_be_written(cli: Cli, yard: Yard, tmp_path: Path) -> None:
    config = yard.write(tmp_path)
    (tmp_path / "out").mkdir(mode=0o500)
    outcome = cli("run", config, "-o", tmp_path / "out" / "run", cwd=tmp_path)
    assert_one_line(outcome, 1, "Permission denied")


def test_record_without_a_run(cli: Cli, tmp_path: Path) -> None:
    assert_one_line(cli("record", tmp_path), 2, "no run here")
    assert_one_line(cli("record", tmp_path / "nothing"), 2, "no run here")


@pytest.mark.parametrize("option", ["--from", "--until"])
def test_an_unknown_stage(cli: Cli, yard: Yard, tmp_path: Path, option: str) -> None:
    config = yard.write(tmp_path)
    outcome = cli("run", config, option, "scna", cwd=tmp_path)
    assert_one_line(outcome, 2, option, "scna", ", ".join(stage.name for stage in STAGES))
    assert not (tmp_path / "recordings").exists()
