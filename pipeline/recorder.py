"""Draws the stages of a run into one Rerun recording, which appears whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from spinpipe.pipeline.atomic import commit
from spinpipe.pipeline.context import RunReader

Draw = Callable[[str, RunReader], None]


@contextmanager
def recorder(
    run: str, mode: str, path: Path, preview_points: int, *, keep: bool = False
) -> Iterator[Draw]:
    """Give a function that draws one complete stage.

    Parameters
    ----------
    run : the run's name, part of the recording's id.
    mode : ``save``, ``spawn``, ``connect`` or ``off``.
    path : the file for ``save``; written beside, renamed at the end, also after an error, so
        that the stages up to it can be looked at.
    preview_points : most points of a cloud that are shown.
    keep : leave a file that is there as it is: nothing has changed since it was drawn.
    """
    if mode == "off" or (mode == "save" and keep and path.exists()):
        yield lambda stage, read: None
        return
    from spinpipe.pipeline.draw import DRAW
    from spinpipe.pipeline.recording import close_recording, open_recording

    partial = path.with_name(path.name + ".partial")
    recording = open_recording(run, mode, partial)
    drawn: list[str] = []

    def draw(stage: str, read: RunReader) -> None:
        DRAW[stage](read, recording, preview_points)
        drawn.append(stage)

    try:
        yield draw
    finally:
        close_recording(recording)
        if mode == "save" and drawn:
            commit(partial, path)
        partial.unlink(missing_ok=True)
