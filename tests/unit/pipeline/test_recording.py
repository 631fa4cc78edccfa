"""Where a recording goes, and what is said when it cannot go there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from spinpipe.pipeline.drawing.recording import close_recording, open_recording
from spinpipe.stages.stage import StageError


def test_off_records_nothing(tmp_path: Path) -> None:
    assert open_recording("test", "off", tmp_path / "run.rrd") is None
    assert not list(tmp_path.iterdir())


def test_no_viewer_is_said_before_the_run(tmp_path: Path) -> None:
    with pytest.raises(StageError, match=r"no Rerun viewer answers at .*--rerun save"):
        open_recording("test", "connect", tmp_path / "run.rrd", "rerun+http://127.0.0.1:1/proxy")
    with pytest.raises(StageError, match="cannot be written"):
        open_recording("test", "save", tmp_path / "missing" / "run.rrd")


def test_rerun_is_imported_late() -> None:
    code = "import sys, spinpipe.pipeline.drawing.recording; sys.exit('rerun' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_recordings_in_one_process_leave_no_threads(tmp_path: Path) -> None:
    """A program that runs configs one after the other must not grow."""
    counts: list[int] = []
    for _ in range(5):
        rec = open_recording("test", "save", tmp_path / "run.rrd")
        assert rec is not None
        close_recording(rec, tmp_path / "run.rrd")
        counts.append(len(list(Path("/proc/self/task").iterdir())))
    assert counts[-1] == counts[1]


def test_a_full_disk_is_told_and_does_not_hang(tmp_path: Path) -> None:
    rec = open_recording("test", "save", tmp_path / "run.rrd.partial")
    assert rec is not None
    with pytest.raises(OSError, match="No space") as caught:
        close_recording(rec, Path("/dev/full"))
    assert caught.value.filename == "/dev/full"


def test_a_viewer_without_display_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(StageError, match="no display"):
        open_recording("test", "spawn", tmp_path / "run.rrd")
