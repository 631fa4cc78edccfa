"""Ingest: a cloud of any size becomes tiles in the local frame, with its cameras and the models."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydantic import Field, field_validator

from spinpipe.schemas import CAMERAS, CLOUD, MODELS, SCENE, TILES
from spinpipe.schemas.records import (
    F32,
    F64,
    U8,
    Cameras,
    CloudTile,
    ObjectModel,
    SceneFrame,
    TileIndex,
)
from spinpipe.stages.ingest.object_model import ModelConfig, load_model
from spinpipe.stages.ingest.scatter_file import ScatterFile
from spinpipe.stages.ingest.scene_source import SceneSource, open_scene
from spinpipe.stages.ingest.tiling import POINT, HashSample, kd_split, tiles_of
from spinpipe.stages.stage import Context, InputPath, Progress, Section, StageError

_BYTES_A_POINT = 1000
"""Generous upper bound of the memory that one point of a chunk takes on its way."""
_LARGEST_CHUNK = 1 << 20


class Ingest:
    """Read the scene twice: once to measure it, once to sort its points into tiles."""

    name = "ingest"
    version = 2
    inputs = ()
    outputs = (CLOUD, TILES, SCENE, MODELS, CAMERAS)

    class Config(Section):
        """``[ingest]``, and the ``[[model]]`` sections."""

        scene: InputPath = Field(description="PLY, LAS or LAZ file, or folder of a COLMAP model")
        scale: float = Field(default=1.0, gt=0, description="metres per unit of the scene")
        tile_points: int = Field(
            default=262_144, ge=1024, le=1_048_576, description="most points of a tile"
        )
        models: tuple[ModelConfig, ...] = Field(min_length=1, description="objects to look for")

        @field_validator("models")
        @classmethod
        def _unique(cls, models: tuple[ModelConfig, ...]) -> tuple[ModelConfig, ...]:
            names = [model.name for model in models]
            twice = next((name for name in names if names.count(name) > 1), None)
            if twice is not None:
                raise ValueError(f"two models have the name '{twice}'; rename one")
            return models

    def run(self, ctx: Context[Config]) -> None:
        """Write the cloud's tiles, then their index, the scene's frame, the models, the cameras."""
        config = ctx.config
        models = [load_model(model, ctx.rng) for model in config.models]
        source = open_scene(config.scene)
        extent = _measure(source, ctx)
        if extent.dropped:
            ctx.log(f"left out {extent.dropped:,} points whose coordinates are not finite")
        frame = SceneFrame(
            origin=extent.origin,
            scale=config.scale,
            points=extent.points,
            dropped=extent.dropped,
            coloured=source.coloured,
            source=config.scene.name,
        )
        _require_room(models, extent, config.scale)
        ctx.write(TILES, _write_tiles(source, frame, extent.sample, ctx))
        ctx.write(SCENE, frame)
        for model in models:
            ctx.write(MODELS, model)
        if source.cameras is not None:
            positions, quaternions_xyzw = source.cameras
            local = (positions - np.array(frame.origin)) * frame.scale
            ctx.write(CAMERAS, Cameras(local, quaternions_xyzw))


@dataclass(frozen=True)
class _Extent:
    """What the first pass finds out, in the scene frame."""

    points: int
    dropped: int
    low: F64
    high: F64
    sample: F64

    @property
    def origin(self) -> tuple[float, float, float]:
        """Median of the sample in whole units: far outliers do not cost precision."""
        middle = np.median(self.sample, axis=0) if len(self.sample) else self.low
        x, y, z = (np.rint(middle) + 0.0).tolist()
        return x, y, z


def _measure(source: SceneSource, ctx: Context[Ingest.Config]) -> _Extent:
    path = ctx.config.scene
    sample = HashSample(_chunk_points(ctx.memory_bytes))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    points = 0
    for xyz, _ in _finite(source, ctx.memory_bytes, ctx.progress("points read", source.points)):
        points += len(xyz)
        if len(xyz):
            low, high = np.minimum(low, xyz.min(axis=0)), np.maximum(high, xyz.max(axis=0))
            sample.add(xyz)
    if not source.points:
        raise StageError(f"{path}: the cloud is empty; export it again")
    if not points:
        raise StageError(
            f"{path}: none of its {source.points:,} points has finite coordinates; export it again"
        )
    return _Extent(points, source.points - points, low, high, sample.points)


def _finite(source: SceneSource, memory: int, progress: Progress) -> Iterator[tuple[F64, U8]]:
    """Chunks without the points that float32 cannot hold; counts all of them as done."""
    for xyz, rgb in source.chunks(_chunk_points(memory)):
        with np.errstate(over="ignore"):
            finite = np.isfinite(xyz.astype(np.float32)).all(axis=1)
        yield (xyz, rgb) if finite.all() else (xyz[finite], rgb[finite])
        progress.advance(len(xyz))


def _chunk_points(memory: int) -> int:
    return max(1024, min(_LARGEST_CHUNK, memory // _BYTES_A_POINT))


def _write_tiles(
    source: SceneSource, frame: SceneFrame, sample: F64, ctx: Context[Ingest.Config]
) -> TileIndex:
    """Second pass: scatter the points to the leaves of a k-d split, then write leaf by leaf."""
    most = ctx.config.tile_points
    split = kd_split(_local(sample, frame), frame.points, most)
    low: list[F32] = []
    high: list[F32] = []
    counts: list[int] = []
    with ScatterFile(ctx.scratch / "points", split.leaves) as scatter:
        sorting = ctx.progress("points sorted", source.points)
        for xyz, rgb in _finite(source, ctx.memory_bytes, sorting):
            points = np.empty(len(xyz), POINT)
            points["xyz"], points["rgb"] = _local(xyz, frame), rgb
            scatter.append(points, split.leaf_of(points["xyz"]))
        writing = ctx.progress("points written", frame.points)
        for leaf in range(split.leaves):
            for points in tiles_of(scatter.read(leaf), most):
                tile = CloudTile(
                    np.ascontiguousarray(points["xyz"]), np.ascontiguousarray(points["rgb"])
                )
                ctx.write(CLOUD, tile)
                low.append(tile.xyz.min(axis=0))
                high.append(tile.xyz.max(axis=0))
                counts.append(len(points))
                writing.advance(len(points))
    return TileIndex(np.stack(low), np.stack(high), np.array(counts, np.int64))


def _local(xyz: F64, frame: SceneFrame) -> F32:
    """Scene -> local frame; adding 0 turns -0.0 into 0.0, so that equal points are equal bits."""
    return ((xyz - np.array(frame.origin)) * frame.scale).astype(np.float32) + np.float32(0)


def _require_room(models: list[ObjectModel], extent: _Extent, scale: float) -> None:
    """Refuse a model that is wider than the whole scene: one of the scales must be wrong."""
    scene_m = float((extent.high - extent.low).max()) * scale
    for model in models:
        surface = model.vertices if len(model.vertices) else model.points
        model_m = float(np.ptp(surface[:, :2], axis=0).max())
        if model_m > scene_m:
            raise StageError(
                f"model '{model.name}' is {model_m:.3g} m wide, the whole scene {scene_m:.3g} m; "
                f"correct ingest.scale (now {scale:g}) or the scale of that [[model]]"
            )
