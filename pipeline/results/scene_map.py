"""``detections.png``: the scene from above with what became of the candidates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.sheet import Colour, Sheet
from spinpipe.pipeline.drawing.top_view import TopView, dimmed, top_view
from spinpipe.pipeline.results.instances import ReadTopic
from spinpipe.schemas import CLOUD, SCENE, TILES, UPRIGHT
from spinpipe.schemas.arrays import F32, U8
from spinpipe.schemas.records import Detection
from spinpipe.stages.geometry.frames import to_world
from spinpipe.stages.geometry.world_cloud import WorldCloud

LEAST_SHARE = 0.35
"""A picture shows at least this part of the scene's extent, however close the objects stand."""


def scene_view(read: ReadTopic, detections: Sequence[Detection], width: int = 1600) -> TopView:
    """The cloud from above: where candidates are, with a margin, and not only a corner of it."""
    upright, tiles = read(UPRIGHT)[0], read(CLOUD)
    cloud = WorldCloud.of(tiles, read(TILES)[0], upright)
    low, high = cloud.low[:, :2].min(axis=0), cloud.high[:, :2].max(axis=0)
    if detections:
        places = np.array([d.position_world[:2] for d in detections])
        size = float(np.median([max(d.size_m[:2]) for d in detections]))
        middle = (places.min(axis=0) + places.max(axis=0)) / 2
        half = np.ptp(places, axis=0) / 2 * 1.05 + 2 * size
        half = np.maximum(half, LEAST_SHARE * (high - low) / 2)
        low, high = np.maximum(low, middle - half), np.minimum(high, middle + half)

    def pieces() -> Iterator[tuple[F32, U8]]:
        for tile in tiles:
            yield to_world(upright, tile.xyz), tile.rgb

    return top_view(pieces, low, high, coloured=read(SCENE)[0].coloured, width=width)


def write_scene_map(view: TopView, detections: Sequence[Detection], path: Path) -> None:
    """Draw footprints by fate over the view, ids beside the accepted, and write a PNG."""
    image = Image.fromarray(dimmed(view.pixels, 0.65))
    sheet = Sheet(image, view)
    by_fate = sorted(detections, key=lambda d: (palette.rank(d.fate), d.score), reverse=True)
    for d in by_fate:  # what matters most is drawn last
        if d.fate in palette.KEPT:
            sheet.footprint(d, _colour(d.fate))
        else:
            sheet.cross(d, _colour(d.fate), 0.15, 1)
    for d in reversed(by_fate):
        if d.fate in palette.KEPT:
            sheet.label(d, str(d.id), _colour(d.fate))
    counts = Counter(d.fate for d in detections)
    fates = sorted(counts, key=palette.rank)
    sheet.legend([(_colour(fate), f"{counts[fate]} {fate}") for fate in fates])
    image.save(path, format="PNG")


def _colour(fate: str) -> Colour:
    red, green, blue = palette.fate_colour(fate)[:3]
    return red, green, blue
