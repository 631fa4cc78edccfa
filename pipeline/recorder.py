"""Draws the stages of a run into one Rerun recording, which appears whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from spinpipe.pipeline.atomic import commit, partial_file
from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.drawing.recording import (
    RecordMode,
    close_recording,
    open_recording,
    record_stage,
)

if TYPE_CHECKING:
    from spinpipe.pipeline.drawing.threshold import Truth

Draw = Callable[[str, RunReader], None]


@contextmanager
def recorder(
    run: str,
    mode: RecordMode,
    path: Path,
    preview_points: int,
    *,
    keep: bool = False,
    truth: Truth | None = None,
) -> Generator[Draw]:
    """Give a function that draws one complete stage.

    Parameters
    ----------
    run : the run's name, part of the recording's id.
    mode : see ``open_recording``.
    path : the file; written beside, renamed at the end, also after an error, so that the stages
        up to it can be looked at.
    preview_points : most points of a cloud that are shown.
    keep : leave a file that is there as it is: nothing has changed since it was drawn.
    truth : what labels say about the detections, to colour them by.
    """
    if mode == "save" and keep and path.exists():
        mode = "off"

    with partial_file(path) as partial:
        recording = open_recording(run, mode, partial)
        if recording is None:
            yield _draw_nothing
            return
        drawn: list[str] = []

        def draw(stage: str, read: RunReader) -> None:
            record_stage(stage, read, recording, preview_points, truth)
            drawn.append(stage)

        try:
            yield draw
        finally:
            close_recording(recording)
            if drawn:
                commit(partial, path)


def _draw_nothing(_stage: str, _read: RunReader) -> None:
    """Stand in where nothing is recorded."""
