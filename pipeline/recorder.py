"""Draws the stages of a run into one Rerun recording, which appears whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from typing import TYPE_CHECKING

from spinpipe.pipeline.atomic import commit, partial_file
from spinpipe.pipeline.config import RunConfig
from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.drawing.recording import (
    RecordMode,
    close_recording,
    open_recording,
    record_stage,
)
from spinpipe.pipeline.keys import content_digest, content_hash
from spinpipe.pipeline.outputs import Outputs
from spinpipe.pipeline.run_folder import RunFolder

if TYPE_CHECKING:
    from spinpipe.pipeline.drawing.threshold import Truth

Draw = Callable[[str, RunReader], None]


def recording_key(config: RunConfig, keys: Mapping[str, str]) -> str:
    """What a recording is drawn from and how: keys of its stages, settings, the drawing code."""
    how = (config.run.name, config.record.preview_points, version("rerun-sdk"))
    text = json.dumps([dict(keys), how, content_digest("drawing")])
    return content_hash(text.encode())


@contextmanager
def recorder(
    config: RunConfig,
    folder: RunFolder,
    mode: RecordMode,
    outputs: Outputs,
    keys: Mapping[str, str],
    truth: Truth | None = None,
) -> Generator[Draw]:
    """Give a function that draws one complete stage.

    Parameters
    ----------
    config, folder, outputs : of the run. The file is written beside and renamed at the end, also
        after an error, so that the stages up to it can be looked at.
    mode : see ``open_recording``; a file that is current is not written again.
    keys : of the stages by name.
    truth : what labels say about the detections, to colour them by.
    """
    path = folder.recording
    if mode == "save" and outputs.current(path, recording_key(config, keys)):
        mode = "off"
    with partial_file(path) as partial:
        recording = open_recording(config.run.name, mode, partial)
        if recording is None:
            yield _draw_nothing
            return
        drawn: dict[str, str] = {}

        def draw(stage: str, read: RunReader) -> None:
            record_stage(stage, read, recording, config.record.preview_points, truth)
            drawn[stage] = keys[stage]

        try:
            yield draw
        finally:
            close_recording(recording, partial)
            if drawn:
                commit(partial, path)
                outputs.written(path, recording_key(config, drawn))


def _draw_nothing(_stage: str, _read: RunReader) -> None:
    """Stand in where nothing is recorded."""
