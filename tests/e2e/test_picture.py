"""What a viewer shows of a run: nothing to complain about, and boxes in the colours of fates."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.conftest import Cli, YardRun

from spinpipe.pipeline.drawing.palette import ACCEPTED, EXPLAINED
from spinpipe.pipeline.drawing.recording import find_viewer
from spinpipe.pipeline.drawing.render import render
from spinpipe.pipeline.drawing.timelines import candidate_step

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


@needs_driver
def test_a_candidate_and_the_threshold_are_drawn(
    cli: Cli, yard_run: YardRun, tmp_path: Path
) -> None:
    """Points explained in the pane of the candidate, and nothing to complain about anywhere."""
    assert cli("record", yard_run.output).code == 0
    recording = yard_run.output / "run.rrd"
    accepted = next(d["id"] for d in yard_run.detections() if d["fate"] == "accepted")
    rejected = [d["id"] for d in yard_run.detections() if d["fate"] == "rejected"]
    shown: dict[str, int] = {}
    steps = {"accepted": accepted} | ({"rejected": rejected[0]} if rejected else {})
    for fate, number in steps.items():
        picture = tmp_path / f"{fate}.png"
        assert render(recording, picture, "candidate", candidate_step(number), (1600, 900)) == []
        pixels = np.asarray(Image.open(picture)).astype(int)
        pane = pixels[: pixels.shape[0] // 2, pixels.shape[1] * 6 // 11 :]
        shown[fate] = int((np.abs(pane - EXPLAINED).max(axis=-1) < 30).sum())
    assert shown["accepted"] > 300
    if rejected:
        assert shown["rejected"] < shown["accepted"]
    assert render(recording, tmp_path / "threshold.png", "threshold", 60, (1000, 600)) == []
