"""Where a recording goes, and what is said when it cannot go there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from spinpipe.pipeline.drawing.recording import open_recording
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
