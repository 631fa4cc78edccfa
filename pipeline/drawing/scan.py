"""Draw the scan: correlation of every origin, hits, histograms and spin images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.drawing import (
    CANDIDATE,
    WORLD,
    Reader,
    at_stage,
    at_stages,
    note,
    put,
    turn_upright,
)
from spinpipe.pipeline.drawing.model import model_path
from spinpipe.pipeline.drawing.preview import preview, preview_rows
from spinpipe.schemas import HITS, SCORES, SPIN_IMAGES, UPRIGHT
from spinpipe.schemas.arrays import F32, I64, U8
from spinpipe.schemas.records import Hits, ScoreTile, SpinImage

_TILES_WORTH_IT = 4
"""Fewer steps tell no story."""
_BINS = np.linspace(-1, 1, 101)


def draw(read: Reader, rec: rr.RecordingStream, preview_points: int) -> None:
    """Log correlations tile by tile, and the best spin image of each model beside the model's."""
    scores = read(SCORES)
    # two passes over the file keep one tile in memory at a time
    counts = [len(tile.points) for tile in scores]
    histogram: dict[str, I64] = {}
    by_tile = len(scores) >= _TILES_WORTH_IT
    if by_tile:
        rec.reset_time()
        rec.set_time("tile", sequence=0)
        turn_upright(rec, read(UPRIGHT)[0])
        rec.log("frames/candidate", rr.Transform3D(child_frame=CANDIDATE, parent_frame=WORLD))
    for piece in preview(_counted(scores, histogram), counts, preview_points):
        at_stage(rec, "scan")
        if by_tile:
            rec.set_time("tile", sequence=piece.last_tile)
        shape = rr.Points3D(piece.xyz, colors=piece.rgb)
        put(rec, f"scan/correlation/{piece.number:04d}", shape, WORLD)
    at_stage(rec, "scan")
    hits, images = read(HITS), read(SPIN_IMAGES)
    for model, bars in histogram.items():
        _draw_histogram(rec, model_path("scan/histogram", model), bars, palette.MARK)
    for group in hits:
        path = f"{model_path('scan/histogram', group.model)}/hits"
        _draw_histogram(rec, path, np.histogram(group.correlation, _BINS)[0], palette.HIT)
    for image in images:
        _draw_spin_image(rec, image)
    note(rec, _summary(sum(counts), hits, images))
    at_stages(rec, "scan/hits", "scan", "cluster")
    for group in hits:
        _draw_hits(rec, group, preview_points)


def _counted(tiles: Sequence[ScoreTile], histogram: dict[str, I64]) -> Iterator[tuple[F32, U8]]:
    """Points and colours of every tile; on the way its correlations are added to the histogram."""
    for tile in tiles:
        for column, model in enumerate(tile.models):
            scores = tile.correlation[:, column]
            counts, _ = np.histogram(scores[scores > -1], _BINS)  # -1: given up, a sure miss
            histogram[model] = histogram.get(model, np.zeros(len(counts), np.int64)) + counts
        yield tile.points, tile.rgb


def _draw_histogram(rec: rr.RecordingStream, path: str, counts: I64, color: palette.Colour) -> None:
    # hits are one origin in a thousand: only a logarithm shows both sides of the threshold
    rec.log(
        path,
        rr.BarChart(
            np.log10(1 + counts),
            abscissa=(_BINS[1:] + _BINS[:-1]) / 2,
            widths=np.diff(_BINS),
            color=color,
        ),
    )


def _draw_hits(rec: rr.RecordingStream, hits: Hits, preview_points: int) -> None:
    (rows,) = preview_rows([len(hits.points)], preview_points)
    shape = rr.Points3D(hits.points[rows], colors=palette.HIT, radii=-2.5)
    put(rec, model_path("scan/hits", hits.model), shape, WORLD)


def _draw_spin_image(rec: rr.RecordingStream, image: SpinImage) -> None:
    rec.log(
        f"{model_path('scan/spin_image', image.model)}/{image.role}",
        rr.DepthImage(
            image.values,
            colormap="viridis",
            depth_range=(0.0, max(float(image.values.max(initial=0)), 1.0)),
            magnification_filter="nearest",
        ),
    )


def _summary(origins: int, hits: Sequence[Hits], images: Sequence[SpinImage]) -> str:
    best = {image.model: image for image in images if image.role == "scene"}
    lines = [
        "## Scan",
        f"{origins:,} origins have a correlation",
        "",
        "| model | hits | best correlation | spin image |",
        "|---|---|---|---|",
    ]
    for group in hits:
        image = best.get(group.model)
        text = (
            f"{image.correlation:.3f} | {image.radius_m:.2f} x {image.height_m:.2f} m, "
            f"bins of {image.bin_m:.3f} m"
            if image
            else "- | -"
        )
        lines.append(f"| {group.model} | {len(group.points):,} | {text} |")
    return "\n".join(lines)
