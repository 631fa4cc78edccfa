"""What was read is what the key says, and what cannot be read is refused at once."""

from __future__ import annotations

import os
import shutil
from typing import TYPE_CHECKING, Any
from unittest import mock

import pytest

from spinpipe.stages.ingest import ingest

if TYPE_CHECKING:
    from tests.conftest import Cli, YardRun


@pytest.mark.parametrize("how", ["written", "replaced", "there and back"])
def test_an_input_that_changes_while_it_is_read_is_not_taken(
    cli: Cli, yard_run: YardRun, how: str
) -> None:
    scene = yard_run.folder / "scene.ply"
    other = yard_run.folder / "other.ply"
    other.write_bytes(scene.read_bytes()[:-1] + b"\x01")
    opened = ingest.open_scene

    def late(*arguments: Any) -> Any:
        aside = yard_run.folder / "aside.ply"
        if how == "written":
            times = scene.stat()
            scene.write_bytes(other.read_bytes())
            os.utime(scene, ns=(times.st_atime_ns, times.st_mtime_ns))
        elif how == "replaced":
            other.replace(scene)
        else:
            scene.replace(aside)
            shutil.copy(other, scene)
            aside.replace(scene)
        return opened(*arguments)

    run = ("run", yard_run.config, "-o", yard_run.output, "--rerun", "off", "--until", "ingest")
    with mock.patch.object(ingest, "open_scene", late):
        outcome = cli(*run, "--from", "ingest")
    assert outcome.code == 1
    assert "an input was changed while it was read" in outcome.err
    assert cli(*run).code == 0


@pytest.mark.parametrize("key", ["ingest.scene", "model.0.path"])
def test_what_is_no_file_is_refused_at_once(cli: Cli, yard_run: YardRun, key: str) -> None:
    pipe, loop = yard_run.folder / "pipe.ply", yard_run.folder / "loop.ply"
    os.mkfifo(pipe)
    loop.symlink_to(loop)
    for value, said in [
        (str(pipe), "is neither a file nor a folder"),
        (str(loop), "a link that leads to itself"),
        ('"a\\u0000b.ply"', "zero byte"),
        ("b\udcff.ply", "is not UTF-8"),
        ("/dev/zero", "is neither a file nor a folder"),
    ]:
        outcome = cli("plan", yard_run.config, "--set", f"{key}={value}")
        assert outcome.code in (1, 2), (value, outcome)
        assert said in outcome.err, (value, outcome)
        assert outcome.err.count("\n") == 1


def test_a_folder_with_the_run_inside_is_the_same_input(cli: Cli, yard_run: YardRun) -> None:
    model = yard_run.folder / "model"
    model.mkdir()
    (model / "points3D.txt").write_text(
        "".join(f"{i} {i % 40 / 4} {i // 40 / 4} {i % 7 / 100} 9 9 9 0\n" for i in range(1600))
    )
    run = ("run", yard_run.config, "-o", model / "run", "--rerun", "off", "--until", "ingest")
    assert cli(*run, "--set", f"ingest.scene={model}").code == 0
    assert "reuse ingest" in cli(*run, "--set", f"ingest.scene={model}").out
