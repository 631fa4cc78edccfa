"""A picture of a recording, taken by a viewer without a window.

Needs a Vulkan driver; the software one of Mesa will do (``mesa-vulkan-drivers``).
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from spinpipe.pipeline.drawing.drawing import STAGE_NUMBER
from spinpipe.pipeline.drawing.recording import find_viewer
from spinpipe.stages.stage import StageError

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

_PATIENCE_S = 180.0


def render(
    recording: Path,
    picture: Path,
    timeline: str = "stage",
    step: int = STAGE_NUMBER["verify"],
    size: tuple[int, int] = (1600, 900),
) -> list[str]:
    """Write a PNG of the whole viewer with the time cursor at one step of a timeline.

    Parameters
    ----------
    recording : file of a run
    picture : file to write
    timeline, step : where the time cursor stands
    size : width and height of the window in points

    Returns
    -------
    What the views had to complain about, nothing for a recording without faults.

    Raises
    ------
    StageError
        When there is no viewer, or when it does not answer.
    """
    viewer = find_viewer()
    if viewer is None:
        raise StageError("no Rerun viewer found: install rerun-sdk with its command line")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    process = subprocess.Popen(
        [
            viewer,
            "--headless",
            "--hide-welcome-screen",
            *("--port", str(port)),
            *("--window-size", f"{size[0]}x{size[1]}"),
        ],
        env={"XDG_RUNTIME_DIR": "/tmp", **os.environ, "RUST_LOG": "off"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        client = _connect(f"rerun+http://127.0.0.1:{port}/proxy")
        client.open(str(recording.resolve()))
        _show_only_the_views(client)
        client.set_time(timeline, sequence=step, play_state="paused")
        _write_cropped(_steady_screenshot(client), picture)
        views = client.get_state().views
        return [f"{view.name}: {report.summary}" for view in views for report in view.reports]
    finally:
        os.killpg(process.pid, signal.SIGKILL)  # ``rerun`` is a script that starts the viewer
        process.wait()


def _write_cropped(png: bytes, picture: Path) -> None:
    """Write a screenshot without the empty bar that a window without title leaves on top."""
    from PIL import Image

    image = Image.open(BytesIO(png)).convert("RGB")
    rows = np.asarray(image)[:, image.width // 4 : -image.width // 4]
    top = int(np.argmax(rows.std(axis=1).max(axis=1) > 1))
    image.crop((0, top, *image.size)).save(picture, optimize=True)


def _connect(url: str) -> ViewerClient:
    from rerun.experimental import ViewerClient

    deadline = time.monotonic() + _PATIENCE_S
    while True:
        try:
            client = ViewerClient.connect(url)
            client.get_state()
            return client
        except (ConnectionError, RuntimeError) as error:
            if time.monotonic() > deadline:
                raise StageError(f"the viewer does not answer: {error}") from error
            time.sleep(0.2)


def _show_only_the_views(client: ViewerClient) -> None:
    blueprint = client.get_blueprint("recording").blueprint
    for panel in ("top_panel", "blueprint_panel", "selection_panel", "time_panel"):
        state = "Collapsed" if panel == "time_panel" else "Hidden"
        archetype = "TimePanelBlueprint" if panel == "time_panel" else "PanelBlueprint"
        blueprint.setdefault(f"/{panel}", {}).setdefault(archetype, {})["state"] = state
    client.set_blueprint(blueprint, "recording")


def _steady_screenshot(client: ViewerClient) -> bytes:
    """Two equal pictures in a row, taken half a second apart: everything is loaded and drawn."""
    deadline = time.monotonic() + _PATIENCE_S
    before = b""
    while True:
        time.sleep(0.5)
        try:
            loading = client.get_state().loading
            now = client.take_screenshot()
        except TimeoutError:  # a million points on a busy machine without a GPU
            loading, now = ["viewer"], b""
        if now == before and not loading:
            return now
        if time.monotonic() > deadline:
            raise StageError("the viewer's picture does not come to rest; show fewer points")
        before = now
