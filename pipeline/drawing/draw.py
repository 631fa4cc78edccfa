"""The drawing of every stage, by the stage's name."""

from __future__ import annotations

from collections.abc import Callable

import rerun as rr

from spinpipe.pipeline.drawing.cluster import draw_cluster
from spinpipe.pipeline.drawing.drawing import Reader
from spinpipe.pipeline.drawing.ground import draw_ground
from spinpipe.pipeline.drawing.ingest import draw_ingest
from spinpipe.pipeline.drawing.scan import draw_scan
from spinpipe.pipeline.drawing.verify import draw_verify

DrawFunction = Callable[[Reader, rr.RecordingStream, int], None]
"""``draw(read, recording, preview_points)``: at most ``preview_points`` points an entity group."""

DRAW: dict[str, DrawFunction] = {
    "ingest": draw_ingest,
    "ground": draw_ground,
    "scan": draw_scan,
    "cluster": draw_cluster,
    "verify": draw_verify,
}
