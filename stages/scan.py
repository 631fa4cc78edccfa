"""Stage 3: the spin image of every model correlated with the one at every scene point.

[Bovenkamp 2010], sections 2.1 and 2.2: upright objects need one spin image each, taken at the
model's topmost point about the vertical; scene points whose own image correlates are hits.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from pydantic import Field

from spinpipe.schemas import CLOUD, HITS, MODELS, SCORES, SPIN_IMAGES, TILES, UPRIGHT
from spinpipe.schemas.colormap import viridis
from spinpipe.schemas.records import F32, F64, Hits, ObjectModel, ScoreTile, SpinImage
from spinpipe.stages.neighbourhood import WorldCloud
from spinpipe.stages.spin_image import (
    SpinGrid,
    SpinTemplate,
    spin_image,
    template_from_cloud,
    topmost_point,
)
from spinpipe.stages.spin_kernel import build_index, correlate
from spinpipe.stages.stage import Context, Section
from spinpipe.stages.voxels import voxel_representatives


class Scan:
    """Correlates the scene's spin images with those of the models."""

    name = "scan"
    version = 1
    inputs = (CLOUD, TILES, MODELS, UPRIGHT)
    outputs = (SCORES, SPIN_IMAGES, HITS)

    class Config(Section):
        """What a spin image covers and when it counts as a hit."""

        radius_m: float | None = Field(
            None, gt=0, le=1000, description="horizontal reach; none: half the model's diagonal"
        )
        height_m: float | None = Field(
            None, gt=0, le=1000, description="reach below the top; none: 0.7 of the model's height"
        )
        bin_m: float | None = Field(
            None, gt=0, le=100, description="side of a bin; none: 1/25 of the radius"
        )
        min_correlation: float = Field(
            0.6, gt=-1, lt=1, description="from which an origin is a hit"
        )
        origins: Literal["all", "voxel"] = Field(
            "all", description="every point, or one in each voxel of side bin_m"
        )

    def run(self, ctx: Context[Config]) -> None:
        """Score every tile's origins, then write the spin images and the hits."""
        models = list(ctx.read(MODELS))
        templates = [model_template(model, ctx.config) for model in models]
        cloud = WorldCloud.of(ctx.read(CLOUD), ctx.read_one(TILES), ctx.read_one(UPRIGHT))
        task = _TileTask(
            cloud,
            tuple(model.name for model in models),
            tuple(templates),
            ctx.config.origins == "voxel",
            ctx.threads,
        )
        hits = _HitList(task.models, ctx.config.min_correlation)
        progress = ctx.progress("tiles", len(cloud))
        done = 0
        for scores in ctx.recovered(SCORES):
            hits.add(scores)
            done += 1
            progress.advance()
        if done:
            ctx.log(f"went on from tile {done} of {len(cloud)}")
        for scores in ctx.map(partial(_score_tile, task), range(done, len(cloud))):
            ctx.write(SCORES, scores)
            hits.add(scores)
            progress.advance()
        found = hits.collect()
        for model, template in zip(models, templates, strict=True):
            ctx.write(SPIN_IMAGES, _model_image(model, template))
        for best, template in zip(found, templates, strict=True):
            if len(best.points):
                ctx.write(SPIN_IMAGES, _scene_image(cloud, best, template))
        for model_hits in found:
            ctx.write(HITS, model_hits)
            ctx.log(f"{len(model_hits.points)} hits of {model_hits.model}")


@dataclass(frozen=True)
class _TileTask:
    """What a worker needs to score any tile; can be pickled."""

    cloud: WorldCloud
    models: tuple[str, ...]
    templates: tuple[SpinTemplate, ...]
    voxels: bool
    threads: int


def _score_tile(task: _TileTask, tile: int) -> ScoreTile:
    """Correlation of every origin of one tile with every template."""
    radius_m = max(t.grid.radius_m for t in task.templates)
    height_m = max(t.grid.height_m for t in task.templates)
    side_m = min(t.grid.bin_m for t in task.templates)
    around = task.cloud.around(tile, radius_m, height_m, side_m if task.voxels else 0.0)
    origins = task.cloud.points(tile)
    if task.voxels:
        origins = origins[voxel_representatives(origins, around, side_m)]
    index = build_index(around)
    correlation = correlate(index, origins, task.templates, task.threads).T
    best = correlation.max(axis=1, initial=-1.0)
    return ScoreTile(task.models, origins, np.ascontiguousarray(correlation), viridis(best))


def model_template(model: ObjectModel, config: Scan.Config) -> SpinTemplate:
    """Spin image of a model at its topmost point, sizes from the model where none are given."""
    size = np.ptp(model.points, axis=0)
    radius_m = config.radius_m or float(np.hypot(size[0], size[1])) / 2
    grid = SpinGrid(
        radius_m=radius_m,
        height_m=config.height_m or 0.7 * float(size[2]),
        bin_m=config.bin_m or radius_m / 25,
    )
    return template_from_cloud(model.points, grid)


def _model_image(model: ObjectModel, template: SpinTemplate) -> SpinImage:
    return _image(model.name, "model", template, template.values, topmost_point(model.points), 1.0)


def _scene_image(cloud: WorldCloud, hits: Hits, template: SpinTemplate) -> SpinImage:
    """The scene's image at the best hit."""
    best = int(np.argmax(hits.correlation))
    origin = hits.points[best].astype(np.float64)
    grid = template.grid
    reach = np.array([grid.radius_m, grid.radius_m, grid.height_m])
    points = cloud.inside(origin - reach, origin + [grid.radius_m, grid.radius_m, 0.0])
    image = spin_image(points, origin, grid)
    return _image(hits.model, "scene", template, image, origin, float(hits.correlation[best]))


def _image(
    model: str,
    role: str,
    template: SpinTemplate,
    values: np.ndarray,
    origin: F64,
    correlation: float,
) -> SpinImage:
    grid = template.grid
    x, y, z = origin.tolist()
    return SpinImage(
        model=model,
        role=role,
        radius_m=grid.radius_m,
        height_m=grid.height_m,
        bin_m=grid.bin_m,
        values=values.astype(np.float32),
        origin=(x, y, z),
        correlation=correlation,
    )


class _HitList:
    """Collects hits of all tiles."""

    def __init__(self, models: tuple[str, ...], min_correlation: float) -> None:
        self._models = models
        self._min = np.float32(min_correlation)
        self._points: list[list[F32]] = [[] for _ in models]
        self._correlation: list[list[F32]] = [[] for _ in models]

    def add(self, scores: ScoreTile) -> None:
        for i in range(len(self._models)):
            hit = scores.correlation[:, i] >= self._min
            self._points[i].append(scores.points[hit])
            self._correlation[i].append(scores.correlation[hit, i])

    def collect(self) -> list[Hits]:
        """Hits of each model, sorted by place so that the tiling leaves no trace."""
        found: list[Hits] = []
        for model, points, correlation in zip(
            self._models, self._points, self._correlation, strict=True
        ):
            xyz = np.concatenate([np.empty((0, 3), np.float32), *points])
            order = np.lexsort(xyz.T[::-1])
            values = np.concatenate([np.empty(0, np.float32), *correlation])
            found.append(Hits(model, xyz[order], values[order]))
        return found
