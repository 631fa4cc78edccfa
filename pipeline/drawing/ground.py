"""Draw the ground plane and turn the cloud upright."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.drawing import (
    LOCAL,
    Reader,
    at_stage,
    at_stages,
    note,
    put,
    turn_upright,
)
from spinpipe.pipeline.drawing.preview import preview
from spinpipe.schemas import CLOUD, PLANE, TILES, UPRIGHT
from spinpipe.schemas.arrays import F64
from spinpipe.schemas.colormap import viridis
from spinpipe.schemas.records import Plane, TileIndex, Upright
from spinpipe.stages.geometry.frames import to_world

_HEIGHT_SHARES = (2, 98)
"""Percentiles of the height that the colours span: a pole or a bird takes none of them."""


def draw(read: Reader, rec: rr.RecordingStream, preview_points: int) -> None:
    """Log the plane where it was found, its normal, and the transform that makes it level.

    Plane and cloud hang below the local frame, so both turn together: a plane that does not end
    up level would show a wrong transform.
    """
    plane, upright, tiles = read(PLANE)[0], read(UPRIGHT)[0], read(TILES)[0]
    at_stage(rec, "ground")
    turn_upright(rec, upright)
    corners, centre, size = _square(plane, upright.T_world_local, tiles)
    note(rec, _summary(plane))
    _draw_heights(read, rec, preview_points, upright, tiles)
    at_stages(rec, "ground", "ground", "ground")
    put(
        rec,
        "ground/plane",
        rr.Mesh3D(
            vertex_positions=corners,
            triangle_indices=[[0, 1, 2], [0, 2, 3]],
            albedo_factor=palette.GROUND,
        ),
        LOCAL,
    )
    put(
        rec,
        "ground/normal",
        rr.Arrows3D(
            origins=[centre],
            vectors=[np.array(plane.normal) * 0.12 * size],
            colors=palette.MARK,
            radii=-2.0,
            labels="up",
        ),
        LOCAL,
    )


def _draw_heights(
    read: Reader, rec: rr.RecordingStream, preview_points: int, upright: Upright, tiles: TileIndex
) -> None:
    """Log a second colouring of the cloud, which a view may choose: its height over the ground."""
    clouds = ((tile.xyz, tile.rgb) for tile in read(CLOUD))
    pieces = list(preview(clouds, tiles.counts.tolist(), preview_points))
    heights = [to_world(upright, piece.xyz)[:, 2] for piece in pieces]
    if not sum(map(len, heights)):
        return
    low, high = np.percentile(np.concatenate(heights), _HEIGHT_SHARES)
    for piece, z in zip(pieces, heights, strict=True):
        colors = viridis(z, float(low), float(max(high, low + 1e-6)))
        batch = rr.DynamicArchetype(
            "Height", components={"colors": rr.components.ColorBatch(colors)}
        )
        rec.log(f"ingest/cloud/{piece.number:04d}", batch, static=True)


def _square(plane: Plane, T_world_local: F64, tiles: TileIndex) -> tuple[F64, F64, float]:
    """Corners (4, 3) of the plane below the cloud, their centre and side, local frame, metres."""
    low, high = tiles.low.min(axis=0), tiles.high.max(axis=0)
    size = float(np.linalg.norm((high - low)[:2]))
    middle = (low + high).astype(np.float64) / 2
    normal = np.array(plane.normal)
    centre = middle - (normal @ middle + plane.offset) * normal
    x, y = T_world_local[0, :3], T_world_local[1, :3]  # the world's axes, seen from the cloud
    half = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
    corners = np.array([centre + size * (a * x + b * y) for a, b in half])
    return corners, centre, size


def _summary(plane: Plane) -> str:
    tilt_deg = math.degrees(math.acos(min(1.0, abs(plane.normal[2]))))
    share = plane.inliers / max(plane.points, 1)
    lines = [
        "## Ground",
        f"- up decided by: {plane.up_source}",
        f"- the cloud was tilted by {tilt_deg:.2f} degrees",
        f"- {share:.0%} of the surface is ground, rms {plane.rms_m:.3f} m",
        "",
    ]
    if plane.evidence:
        lines += ["| evidence for up (+) or against (-) | value |", "|---|---|"]
        lines += [f"| {item.name} | {item.value:+.3f} |" for item in plane.evidence]
    return "\n".join(lines)
