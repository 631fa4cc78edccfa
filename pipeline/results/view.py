"""``spinpipe view``: the recording of a run in a Rerun viewer, at a candidate if wanted."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from rich.console import Console

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.drawing.recording import find_viewer
from spinpipe.pipeline.drawing.timelines import candidate_step
from spinpipe.pipeline.results.complete import open_run_folder
from spinpipe.pipeline.results.life import find_detection
from spinpipe.schemas import DETECTIONS
from spinpipe.stages.stage import StageError


def view_command(path: Path, candidate: int | None, web: bool) -> None:
    """``spinpipe view``."""
    folder, _ = open_run_folder(path)
    if not folder.recording.exists():
        raise StageError(f"{folder.recording}: no recording yet; spinpipe record {path} draws it")
    if candidate is not None:
        find_detection(RunReader(folder)(DETECTIONS), candidate)
    viewer = find_viewer()
    if viewer is None:
        raise StageError("no Rerun viewer found: install rerun-sdk with its command line")
    if web:
        _serve(viewer, folder.recording, candidate)
    else:
        _open(viewer, folder.recording, candidate)


def _serve(viewer: str, recording: Path, candidate: int | None) -> None:
    if candidate is not None:
        text = f"go to step {candidate_step(candidate)} of the timeline 'candidate'"
        Console().print(text, highlight=False)
    try:
        subprocess.run([viewer, "--web-viewer", str(recording)], check=True)
    except subprocess.CalledProcessError as error:
        raise StageError(f"the viewer ended with code {error.returncode}") from None


def _open(viewer: str, recording: Path, candidate: int | None) -> None:
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise StageError("no display to open a viewer on: use --web, or open report.html")
    from rerun.experimental import ViewerClient

    client = ViewerClient.spawn(executable_path=viewer, detach_process=True)
    client.open(str(recording.resolve()))
    if candidate is not None:
        client.set_time("candidate", sequence=candidate_step(candidate), play_state="paused")
