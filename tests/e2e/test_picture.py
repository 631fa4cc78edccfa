"""What a viewer shows of a run: nothing to complain about, and boxes in the colours of fates."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.conftest import Cli, YardRun

from spinpipe.pipeline.drawing.palette import ACCEPTED
from spinpipe.pipeline.drawing.recording import find_viewer
from spinpipe.pipeline.drawing.render import render

DRIVERS = [Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d")]

needs_driver = pytest.mark.skipif(
    not any(list(folder.glob("*.json")) for folder in DRIVERS), reason="no Vulkan driver"
)


def test_recording_is_sound(cli: Cli, yard_run: YardRun) -> None:
    assert cli("record", yard_run.output).code == 0
    viewer = find_viewer()
    assert viewer is not None
    recording = str(yard_run.output / "run.rrd")
    subprocess.run([viewer, "rrd", "verify", recording], check=True, capture_output=True)


@needs_driver
def test_picture_shows_the_boxes_of_what_was_found(
    cli: Cli, yard_run: YardRun, tmp_path: Path
) -> None:
    assert cli("record", yard_run.output).code == 0
    picture = tmp_path / "picture.png"
    assert render(yard_run.output / "run.rrd", picture, size=(1000, 600)) == []
    pixels = np.asarray(Image.open(picture)).astype(int)
    assert (np.abs(pixels - ACCEPTED).max(axis=-1) < 12).sum() > 100
