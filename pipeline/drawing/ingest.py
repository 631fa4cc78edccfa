"""Draw what ingest read: the cloud and the cameras."""

from __future__ import annotations

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.drawing import CANDIDATE, LOCAL, WORLD, Reader, at_stage, note, put
from spinpipe.pipeline.drawing.photos import draw_cameras, photos_of
from spinpipe.pipeline.drawing.preview import preview
from spinpipe.schemas import CAMERAS, CLOUD, SCENE, TILES, TRAJECTORY
from spinpipe.schemas.arrays import F32, F64
from spinpipe.schemas.poses import Cameras
from spinpipe.schemas.records import SceneFrame, TileIndex
from spinpipe.stages.geometry.frames import quaternion_matrix

CAMERA_SHARE = 0.02
"""Size of a camera, as a share of the scene's diagonal."""


def draw(read: Reader, rec: rr.RecordingStream, preview_points: int) -> None:
    """Log the thinned cloud once for all times, still tilted, with the cameras."""
    scene, tiles = read(SCENE)[0], read(TILES)[0]
    cameras = read(CAMERAS)
    at_stage(rec, "ingest")
    for frame in (LOCAL, CANDIDATE):
        rec.log(f"frames/{frame}", rr.Transform3D(child_frame=frame, parent_frame=WORLD))
    _draw_cloud(read, rec, preview_points, scene, tiles)
    size = float(np.linalg.norm(tiles.high.max(axis=0) - tiles.low.min(axis=0)))
    photos = photos_of(read)
    draw_cameras(rec, photos, CAMERA_SHARE * size)
    for shown in cameras:
        _draw_frusta(rec, shown, {photo.name for photo in photos}, CAMERA_SHARE * size)
    for path in read(TRAJECTORY):
        line = rr.LineStrips3D([path.positions], colors=palette.MARK, radii=-2.0)
        put(rec, "ingest/trajectory", line, LOCAL, static=True)
        ends = rr.Points3D(path.positions, colors=palette.MARK, radii=-3.0)
        put(rec, "ingest/trajectory/sweeps", ends, LOCAL, static=True)
    note(rec, _summary(scene, tiles, sum(len(c.positions) for c in cameras)))


def _draw_cloud(
    read: Reader,
    rec: rr.RecordingStream,
    preview_points: int,
    scene: SceneFrame,
    tiles: TileIndex,
) -> None:
    # radii are left to the views: fixed on the screen from afar, in metres close by
    clouds = ((tile.xyz, tile.rgb) for tile in read(CLOUD))
    for piece in preview(clouds, tiles.counts.tolist(), preview_points):
        colors = piece.rgb
        if not scene.coloured:
            colors = palette.shade(piece.xyz[:, 2], tiles.low[:, 2].min(), tiles.high[:, 2].max())
        shape = rr.Points3D(piece.xyz, colors=colors)
        put(rec, f"ingest/cloud/{piece.number:04d}", shape, LOCAL, static=True)


def _draw_frusta(rec: rr.RecordingStream, cameras: Cameras, known: set[str], size_m: float) -> None:
    """Cameras without a lens: a plain pyramid each."""
    rest = np.array([name not in known for name in cameras.names], bool)
    if rest.any():
        lines = _frusta(cameras.positions[rest], cameras.quaternions_xyzw[rest], size_m)
        frusta = rr.LineStrips3D(lines, colors=palette.MARK, radii=-1.0)
        put(rec, "ingest/cameras", frusta, LOCAL, static=True)


def _frusta(positions: F64, quaternions_xyzw: F64, size: float) -> F32:
    """One line (C, L, 3) a camera: a pyramid that opens to where it looks, up side marked."""
    a, b = 0.75 * size, 0.5 * size
    tip, mark = (0, 0, 0), (0, -1.6 * b, size)
    p, q, r, s = (-a, -b, size), (a, -b, size), (a, b, size), (-a, b, size)
    line = np.array([tip, p, q, tip, r, s, tip, s, p, mark, q, r], np.float64)
    turned = line @ quaternion_matrix(quaternions_xyzw).transpose(0, 2, 1)
    return (turned + positions[:, None, :]).astype(np.float32)


def _summary(scene: SceneFrame, tiles: TileIndex, cameras: int) -> str:
    extent = tiles.high.max(axis=0) - tiles.low.min(axis=0)
    origin = ", ".join(f"{value:.3f}" for value in scene.origin)
    scale = " x ".join(f"{value:g}" for value in dict.fromkeys(scene.scale))
    lines = [
        f"## Ingest: {scene.source}",
        f"- {scene.points:,} points in {len(tiles.counts)} tiles",
        *(
            f"- left out: {count:,} {what}"
            for count, what in (
                (scene.dropped, "without finite coordinates"),
                (scene.strays, "far from all others"),
                (scene.duplicates, "that repeat another"),
            )
            if count
        ),
        "- extent " + " x ".join(f"{length:.1f}" for length in extent) + " m",
        f"- origin ({origin}) in scene coordinates, {scale} m a unit"
        + (f", {scene.crs if len(scene.crs) < 20 else 'with WKT'}" if scene.crs else ""),
        f"- {cameras} cameras" if cameras else "- no cameras",
    ]
    return "\n".join(lines)
