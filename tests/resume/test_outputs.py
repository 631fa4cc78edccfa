"""What a run leaves is made from what is there now, and what is not ours stays as it is."""

from __future__ import annotations

import json
import shutil
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from rerun.chunk import RrdReader

from spinpipe.pipeline.outputs import MARK, Outputs
from spinpipe.stages.stage import StageError

if TYPE_CHECKING:
    from tests.conftest import Cli, Outcome, YardRun

MINE = b"mine, and the only copy"


def run(cli: Cli, yard: YardRun, *options: str) -> Outcome:
    outcome: Outcome = cli("run", yard.config, "-o", yard.output, *options)
    return outcome


def truth(yard: YardRun) -> Path:
    path = yard.folder / "truth.csv"
    path.write_text("x,y\n-3.1,-2.6\n3.0,2.7\n")
    return path


# The recording


def test_a_recording_of_other_settings_does_not_stay(cli: Cli, yard_run: YardRun) -> None:
    recording = yard_run.output / "run.rrd"
    assert run(cli, yard_run).code == 0
    first = recording.read_bytes()
    assert run(cli, yard_run).code == 0
    assert recording.read_bytes() == first, "drawn again for nothing"
    assert run(cli, yard_run, "--set", "verify.icp.samples=400", "--rerun", "off").code == 0
    assert not recording.exists(), "shows another run than the one that is there"
    assert run(cli, yard_run, "--set", "verify.icp.samples=400").code == 0
    assert recording.exists()


def test_a_recording_follows_how_it_is_drawn_and_mends(cli: Cli, yard_run: YardRun) -> None:
    recording = yard_run.output / "run.rrd"
    assert run(cli, yard_run).code == 0
    size = recording.stat().st_size
    assert run(cli, yard_run, "--set", "record.preview_points=2000").code == 0
    assert recording.stat().st_size < 0.9 * size
    recording.write_bytes(recording.read_bytes()[:-1000])
    assert run(cli, yard_run, "--set", "record.preview_points=2000").code == 0
    assert RrdReader(recording).store().summary()
    assert run(cli, yard_run, "--until", "ground", "--rerun", "off").code == 0


@pytest.mark.parametrize("name", ["detections.json", "report.html", "detections.png"])
def test_damaged_results_are_made_again(cli: Cli, yard_run: YardRun, name: str) -> None:
    path = yard_run.output / name
    whole = path.read_bytes()
    path.write_bytes(whole[:-5])
    assert run(cli, yard_run, "--rerun", "off").code == 0
    assert len(path.read_bytes()) > len(whole) - 5


def test_a_damaged_list_of_files_blocks_nothing(cli: Cli, yard_run: YardRun) -> None:
    mark = yard_run.output / MARK
    mark.write_bytes(mark.read_bytes()[:-40])
    assert run(cli, yard_run, "--rerun", "off").code == 0
    assert json.loads(mark.read_text())["files"]


# The resolved config


def test_the_resolved_config_says_what_the_files_were_made_with(
    cli: Cli, yard_run: YardRun
) -> None:
    def verify() -> str:
        return str(tomllib.loads((yard_run.output / "config.resolved.toml").read_text())["verify"])

    made_with = verify()
    options = ("--until", "cluster", "--set", "verify.icp.samples=400", "--rerun", "off")
    assert run(cli, yard_run, *options).code == 0
    assert verify() == made_with
    assert run(cli, yard_run, "--set", "verify.icp.samples=400", "--rerun", "off").code == 0
    assert "400" in verify()


def test_an_edited_resolved_config_is_not_taken_for_the_run(cli: Cli, yard_run: YardRun) -> None:
    path = yard_run.output / "config.resolved.toml"
    path.write_text(path.read_text().replace("yard", "park"))
    outcome = cli("eval", yard_run.output, "--truth", truth(yard_run))
    assert outcome.code == 1
    assert "config.resolved.toml: is not as the run wrote it" in outcome.err


# Files of others


@pytest.mark.parametrize(
    "name", ["detections.ply", "detections.csv", "report.json", "run.rrd", "01_ingest.mcap"]
)
def test_a_foreign_file_in_the_folder_stays(cli: Cli, yard_run: YardRun, name: str) -> None:
    shutil.rmtree(yard_run.output)
    yard_run.output.mkdir()
    path = yard_run.output / name
    path.write_bytes(MINE)
    outcome = run(cli, yard_run)
    assert outcome.code == 1
    assert f"{name}: is there already" in outcome.err
    assert path.read_bytes() == MINE
    assert run(cli, yard_run, "--force", "--until", "ground", "--rerun", "off").code == 0


def test_a_scene_that_bears_the_name_of_a_result_stays(cli: Cli, yard_run: YardRun) -> None:
    shutil.rmtree(yard_run.output)
    yard_run.output.mkdir()
    scene = yard_run.output / "detections.ply"
    shutil.copy(yard_run.folder / "scene.ply", scene)
    before = scene.read_bytes()
    outcome = run(cli, yard_run, "--set", f'ingest.scene="{scene}"', "--force")
    assert outcome.code == 2
    assert "is where the run would write" in outcome.err
    assert scene.read_bytes() == before


@pytest.mark.parametrize("command", ["cut", "eval", "picture", "export", "diff", "init", "example"])
def test_no_command_replaces_a_file_that_it_did_not_write(
    cli: Cli, yard_run: YardRun, command: str
) -> None:
    mine = yard_run.folder / "mine.ply"
    (yard_run.folder / "example").mkdir()
    for path in (mine, yard_run.folder / "example" / "scene.ply"):
        path.write_bytes(MINE)
    place = ("--at", "3,2.7,0", "--size", "5,2.5,2")
    label = ("eval", yard_run.output, "--truth", truth(yard_run))
    arguments = {
        "cut": ("model", "cut", yard_run.output, *place, "--out", mine),
        "eval": (*label, "--json", mine),
        "picture": (*label, "--picture", mine),
        "export": ("export", yard_run.output, "-f", "ply", "-o", mine),
        "diff": ("diff", yard_run.output, yard_run.output, "--record", mine),
        "init": ("init", mine, "--scene", "a.ply", "--model", "b.ply"),
        "example": ("init", yard_run.folder / "new.toml"),
    }[command]
    outcome = cli(*arguments)
    assert outcome.code == 1
    assert "replace it with --force" in outcome.err
    assert mine.read_bytes() == MINE
    assert (yard_run.folder / "example" / "scene.ply").read_bytes() == MINE
    if command in ("cut", "eval", "export"):
        assert cli(*arguments, "--force").code == 0
        assert mine.read_bytes() != MINE


def test_commands_may_repeat_what_they_wrote_into_the_run(cli: Cli, yard_run: YardRun) -> None:
    for _ in range(2):
        assert cli("eval", yard_run.output, "--truth", truth(yard_run)).code == 0
        assert cli("export", yard_run.output, "-f", "obj").code == 0


def test_a_second_demo_keeps_what_was_edited(cli: Cli, tmp_path: Path) -> None:
    config = tmp_path / "demo" / "config.toml"
    config.parent.mkdir()
    config.write_bytes(MINE)
    assert cli("demo", "-o", config.parent).code == 1
    assert config.read_bytes() == MINE


def test_what_was_edited_is_known(tmp_path: Path) -> None:
    outputs, path = Outputs(tmp_path), tmp_path / "a"
    outputs.claim(path)
    outputs.write(path, "key", lambda file: file.write_text("ours"))
    assert outputs.current(path, "key")
    assert not outputs.edited(path)
    path.write_text("yours")
    assert not outputs.current(path, "key")
    assert Outputs(tmp_path).edited(path)
    outputs.claim(path)
    (tmp_path / "b").write_text("yours")
    with pytest.raises(StageError, match="b: is there already"):
        outputs.claim(tmp_path / "b")


@pytest.mark.parametrize("name", ["../../x", "/tmp/x", "..", "a\\b", "new\nline"])
def test_a_run_cannot_leave_its_folder(cli: Cli, yard_run: YardRun, name: str) -> None:
    outcome = cli("run", yard_run.config, "--set", f"run.name={json.dumps(name)}")
    assert outcome.code == 2
    assert "must be the name of one folder" in outcome.err
