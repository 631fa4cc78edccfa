"""The drawing of every stage, by the stage's name."""

from __future__ import annotations

from collections.abc import Callable

import rerun as rr

from spinpipe.pipeline.draw_cluster import draw_cluster
from spinpipe.pipeline.draw_ground import draw_ground
from spinpipe.pipeline.draw_ingest import draw_ingest
from spinpipe.pipeline.draw_scan import draw_scan
from spinpipe.pipeline.draw_verify import draw_verify
from spinpipe.pipeline.drawing import Reader

DrawFunction = Callable[[Reader, rr.RecordingStream, int], None]
"""``draw(read, recording, preview_points)``: at most ``preview_points`` points an entity group."""

DRAW: dict[str, DrawFunction] = {
    "ingest": draw_ingest,
    "ground": draw_ground,
    "scan": draw_scan,
    "cluster": draw_cluster,
    "verify": draw_verify,
}
