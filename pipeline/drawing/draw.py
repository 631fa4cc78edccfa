"""The drawing of every stage: the ``draw`` of the module that is called like it."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import rerun as rr

from spinpipe.pipeline.drawing.drawing import Reader
from spinpipe.stages import STAGES

DrawFunction = Callable[[Reader, rr.RecordingStream, int], None]
"""``draw(read, recording, preview_points)``: at most ``preview_points`` points an entity group."""

DRAW: dict[str, DrawFunction] = {
    stage.name: import_module(f"spinpipe.pipeline.drawing.{stage.name}").draw for stage in STAGES
}
