"""``spinpipe view``: the recording of a run in a Rerun viewer, at a candidate if wanted."""

from __future__ import annotations

import os
import socket
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

WEB_PORT, DATA_PORT = 9090, 9876
"""Rerun's defaults."""


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
    """Serve on Rerun's own ports, on others where somebody else serves there."""
    web, data = _free_port(WEB_PORT), _free_port(DATA_PORT)
    if candidate is not None:
        text = f"go to step {candidate_step(candidate)} of the timeline 'candidate'"
        Console().print(text, highlight=False)
    Console().print(f"serving at http://127.0.0.1:{web} until Ctrl-C", highlight=False)
    try:
        ports = (f"--web-viewer-port={web}", f"--port={data}")
        subprocess.run([viewer, "--web-viewer", *ports, str(recording)], check=True)
    except subprocess.CalledProcessError as error:
        raise StageError(f"the viewer ended with code {error.returncode}") from None


def _free_port(wanted: int) -> int:
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("", port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise StageError("no port is free to serve the recording on")


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
