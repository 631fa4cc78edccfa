"""Ingest: a cloud of any size becomes tiles in the local frame, with its cameras."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from spinpipe.schemas import CALIBRATIONS, CAMERAS, CLOUD, SCENE, TILES, TRAJECTORY
from spinpipe.schemas.arrays import F32
from spinpipe.schemas.records import CloudTile, SceneFrame, TileIndex, Vector
from spinpipe.stages.geometry.columns import extremes
from spinpipe.stages.ingest.known_scale import ScaleFrom, gps_says, known_scale
from spinpipe.stages.ingest.odometry import Odometry, registered
from spinpipe.stages.ingest.point_blocks import to_local
from spinpipe.stages.ingest.readers.mcap import McapSource
from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.ingest.readers.scene_source import SceneSource, held
from spinpipe.stages.ingest.sanity import (
    believable,
    coarse_steps,
    on_the_ground,
    refuse_degrees,
    require_on_earth,
    scale_note,
    scale_of,
    scene_line,
)
from spinpipe.stages.ingest.scatter_file import ScatterFile
from spinpipe.stages.ingest.survey import Survey, finite, left_out, survey, within
from spinpipe.stages.ingest.tiling import POINT, kd_split, tiles_of
from spinpipe.stages.stage import Context, InputPath, Scale, Section, StageError
from spinpipe.stages.threads import map_threads

_BYTES_A_POINT = 1000
"""Generous upper bound of the memory that one point of a chunk takes on its way."""
_LARGEST_CHUNK = 1 << 20


class Ingest:
    """Look at the scene twice: once to measure it, once to sort its points into tiles."""

    name = "ingest"
    version = 3
    inputs = ()
    outputs = (CLOUD, TILES, SCENE, CAMERAS, CALIBRATIONS, TRAJECTORY)

    class Config(Section):
        """Which scene, and how it is cut into tiles."""

        scene: InputPath = Field(
            description="cloud or mesh in any common format, or folder of a COLMAP model"
        )
        scale: Scale | tuple[Scale, Scale, Scale] | Literal["search"] | None = Field(
            default=None,
            description="metres per unit of the scene, or [x, y, z] where z has another; "
            "none: as the file says, else 1; 'search': what the models are found at, from 0.2 to 5",
        )
        topic: str | None = Field(
            default=None, description="of an MCAP file that holds clouds on several"
        )
        photos: InputPath | None = Field(
            default=None,
            description="folder of the photos that the cameras are named after, to be shown; none: "
            "where COLMAP leaves them, beside the model",
        )
        tile_points: int = Field(
            default=262_144, ge=1024, le=1_048_576, description="most points of a tile"
        )
        scale_from: ScaleFrom = Field(default_factory=ScaleFrom)
        odometry: Odometry = Field(default_factory=Odometry)

        @model_validator(mode="after")
        def _one_scale(self) -> Ingest.Config:
            if self.scale is not None and self.scale_from.given:
                raise ValueError("scale is stated and [ingest.scale_from] tells it too: keep one")
            return self

    def run(self, ctx: Context[Config]) -> None:
        """Write the cloud's tiles, then their index, the scene's frame, the cameras."""
        config = ctx.config
        if config.scale == "search":
            raise StageError(
                "[ingest] scale is to be searched, which the run does before its stages"
            )
        source = open_scene(config.scene, config.topic)
        if isinstance(source, McapSource) and source.sweeps > 1:
            source = _one_scene(source, ctx)
        source = held(source, ctx.memory_bytes // 4)
        progress = ctx.progress("points read", source.points)
        found = survey(source, str(config.scene), _chunk_points(ctx.memory_bytes), progress)
        said, unlikely = believable(source.about.coordinates, found.low, found.high)
        said, stretched = on_the_ground(said, found.low, found.high)
        photos = config.photos or source.about.photos
        stated: float | Vector | None = config.scale
        if config.scale_from.given:
            stated, note = known_scale(
                config.scale_from, source.about.cameras, config.photos, config.scene
            )
            ctx.log(note)
        by_gps, cameras = "", source.about.cameras
        if stated is None and said.metres is None and cameras is not None and photos is not None:
            by_gps = gps_says(cameras, photos)
        scale = scale_of(stated, said, config.scene)
        require_on_earth(found, scale, config.scene)
        spacing_m = found.spacing(scale)
        ctx.log(scene_line(source, found, scale, spacing_m))
        if stated is None:
            refuse_degrees(found.low, found.high, config.scene)
        steps = coarse_steps(found, scale, spacing_m)
        for note in (
            *source.about.notes,
            *left_out(found),
            unlikely,
            scale_note(stated, said),
            stretched if stated is None else "",
            by_gps,
            f"odd: {steps}" if steps else "",
        ):
            if note:
                ctx.log(note)
        frame = SceneFrame(
            origin=found.origin,
            scale=scale,
            points=found.points - found.strays,
            dropped=found.dropped,
            coloured=source.coloured,
            source=config.scene.name,
            strays=found.strays,
            kind=source.about.kind,
            crs=said.crs,
            up=source.about.known_up or (),
            up_reason=source.about.known_up_reason,
            spacing_m=spacing_m,
            step_m=float(max(np.array(found.steps) * scale)),
            photos=str(photos or ""),
            fields=source.about.fields,
            unit_source=f"{said.name}, {said.source}" if said.metres and not stated else "",
        )
        index = _write_tiles(source, frame, found, ctx)
        points = int(index.counts.sum())
        if points < frame.points:
            ctx.log(f"{frame.points - points:,} points repeat another one: counted once")
        frame = replace(frame, points=points, duplicates=frame.points - points)
        ctx.write(TILES, index)
        ctx.write(SCENE, frame)
        if cameras is not None:
            local = (cameras.positions - np.array(frame.origin)) * np.array(frame.scale)
            ctx.write(CAMERAS, replace(cameras, positions=local))
        for calibration in source.about.calibrations:
            ctx.write(CALIBRATIONS, calibration)
        trajectory = source.about.trajectory
        if trajectory is not None:
            local = (trajectory.positions - np.array(frame.origin)) * np.array(frame.scale)
            ctx.write(TRAJECTORY, replace(trajectory, positions=local))


def _one_scene(log: McapSource, ctx: Context[Ingest.Config]) -> SceneSource:
    """The sweeps of a log in one frame."""
    rules = ctx.config.odometry
    if rules.method == "none" or (rules.method == "auto" and log.in_fixed_frame):
        ctx.log(f"{log.sweeps:,} sweeps are taken as they are: they lie in frame '{log.frame}'")
        return log
    return registered(log, rules, ctx.progress("points registered", log.points).advance)


def _chunk_points(memory: int) -> int:
    return max(1024, min(_LARGEST_CHUNK, memory // _BYTES_A_POINT))


def _write_tiles(
    source: SceneSource, frame: SceneFrame, found: Survey, ctx: Context[Ingest.Config]
) -> TileIndex:
    """Second pass: scatter the points to the leaves of a k-d split, then write leaf by leaf."""
    most = ctx.config.tile_points
    origin, scale = np.array(frame.origin), np.array(frame.scale)
    sample = np.empty(found.sample.shape, np.float32)
    to_local(found.sample, origin, scale, sample)
    split = kd_split(sample, frame.points, most)
    low: list[F32] = []
    high: list[F32] = []
    counts: list[int] = []
    with ScatterFile(ctx.scratch, split.leaves) as scatter:
        sorting = ctx.progress("points sorted", source.points)
        for block in finite(source, _chunk_points(ctx.memory_bytes)):
            sorting.advance(block.read)
            xyz, rgb = block.xyz, block.rgb
            if frame.strays:
                kept = within(xyz, found.keep_low, found.keep_high)
                xyz, rgb = xyz[kept], rgb[kept]
            points = np.empty(len(xyz), POINT)
            to_local(xyz, origin, scale, points["xyz"])
            points["rgb"] = rgb
            scatter.append(points, split.leaf_of(points["xyz"]))
        writing = ctx.progress("points written", frame.points)

        def tiles(leaf: int) -> list[CloudTile]:
            return [
                CloudTile(np.ascontiguousarray(p["xyz"]), np.ascontiguousarray(p["rgb"]))
                for p in tiles_of(scatter.read(leaf), most)
            ]

        for tile in chain.from_iterable(map_threads(tiles, range(split.leaves), ctx.threads)):
            ctx.write(CLOUD, tile)
            lowest, highest = extremes(tile.xyz)
            low.append(lowest)
            high.append(highest)
            counts.append(len(tile.xyz))
            writing.advance(len(tile.xyz))
    return TileIndex(np.stack(low), np.stack(high), np.array(counts, np.int64))
