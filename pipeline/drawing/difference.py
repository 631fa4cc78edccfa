"""Two runs over one scene in one recording: what both found, and what only one did."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import rerun as rr
import rerun.blueprint as rrb

from spinpipe.pipeline.config import RunConfig
from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.boxes import boxes_of
from spinpipe.pipeline.drawing.drawing import WORLD, Reader, put
from spinpipe.pipeline.drawing.eye import scene_corners, scene_eye
from spinpipe.pipeline.drawing.preview import preview
from spinpipe.pipeline.drawing.recording import close_recording, open_recording
from spinpipe.schemas import CLOUD, TILES, UPRIGHT
from spinpipe.schemas.records import Detection
from spinpipe.stages.geometry.frames import to_world

COLOURS = {
    "gained": palette.ACCEPTED,
    "lost": palette.REJECTED,
    "moved": palette.MARK,
    "changed type": palette.AMBIGUOUS,
    "same": palette.PALE,
}


class Difference(Protocol):
    """One object in one or both runs."""

    @property
    def kind(self) -> str:
        """One of ``COLOURS``."""
        ...

    @property
    def before(self) -> Detection | None:
        """In the first run."""
        ...

    @property
    def after(self) -> Detection | None:
        """In the second run."""
        ...


def record_difference(
    read: Reader, differences: Sequence[Difference], config: RunConfig, path: Path
) -> None:
    """Write a recording with the cloud of the second run and boxes of both."""
    rec = open_recording(f"{config.run.name}-difference", "save", path)
    assert rec is not None
    upright, tiles = read(UPRIGHT)[0], read(TILES)[0]
    clouds = ((to_world(upright, tile.xyz), tile.rgb) for tile in read(CLOUD))
    for piece in preview(clouds, tiles.counts.tolist(), config.record.preview_points):
        shape = rr.Points3D(piece.xyz, colors=piece.rgb, radii=-1.2)
        put(rec, f"cloud/{piece.number:04d}", shape, WORLD, static=True)
    for kind, colour in COLOURS.items():
        chosen = [d for d in differences if d.kind == kind]
        for side, radius in (("before", -0.7), ("after", -1.5)):
            boxes = [d.before if side == "before" else d.after for d in chosen]
            shape = _boxes([d for d in boxes if d is not None], colour, radius)
            put(rec, f"{side}/{kind.replace(' ', '_')}", shape, WORLD, static=True)
    view = rrb.Spatial3DView(
        name="before: thin, after: thick; green gained, orange lost, blue moved, yellow other type",
        contents="/**",
        spatial_information=rrb.SpatialInformation(WORLD),
        background=palette.BACKGROUND,
        line_grid=False,
        eye_controls=scene_eye(scene_corners(read)).controls(),
    )
    rec.send_blueprint(rrb.Blueprint(view, collapse_panels=True))
    close_recording(rec, path)


def _boxes(detections: Sequence[Detection], colour: palette.Colour, radius: float) -> rr.Boxes3D:
    boxes = boxes_of(detections)
    return rr.Boxes3D(
        centers=boxes.centers,
        half_sizes=boxes.sizes / 2,
        quaternions=boxes.quaternions,
        colors=colour,
        radii=radius,
        labels=[f"{d.id} {d.model}" for d in detections],
        show_labels=False,
    )
