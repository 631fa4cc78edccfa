"""Stage 4: the spin image of every model correlated with the one at every scene point.

[Bovenkamp 2010], sections 2.1 and 2.2: upright objects need one spin image each, taken about the
vertical through a point of the model's top; scene points whose own image correlates are hits.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import Field

from spinpipe.schemas import (
    CLOUD,
    HITS,
    MODELS,
    SAMPLING,
    SCORES,
    SPIN_IMAGES,
    TILES,
    UPRIGHT,
)
from spinpipe.schemas.arrays import F32, F64
from spinpipe.schemas.records import Hits, ObjectModel, Sampling, ScoreTile, SpinImage
from spinpipe.stages.geometry.frames import vector
from spinpipe.stages.geometry.model_surface import points_on, topmost_point
from spinpipe.stages.geometry.skin import shown
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.scan.coarse_to_fine import VOXEL_RADII
from spinpipe.stages.scan.hit_threshold import hit_threshold
from spinpipe.stages.scan.image import SpinGrid, spin_image
from spinpipe.stages.scan.model_heights import HeightBands
from spinpipe.stages.scan.model_origin import typical_point
from spinpipe.stages.scan.templates import Templates, extent_weights, object_image
from spinpipe.stages.scan.tile import Origins, TileScan
from spinpipe.stages.stage import Context, Section, StageError

RADIUS_HALF_WIDTHS = 1.45
HEIGHT_SHARE = 0.7
BINS_ALONG = 8
BLURS = 4
"""Noisy copies of the model whose mean image is what a noisy scene is compared with."""


class Scan:
    """Correlates the scene's spin images with those of the models."""

    name = "scan"
    version = 3
    inputs = (CLOUD, TILES, MODELS, UPRIGHT, SAMPLING)
    outputs = (SCORES, SPIN_IMAGES, HITS)

    class Config(Section):
        """What a spin image covers, where it is taken and when it counts as a hit."""

        radius_m: float | None = Field(
            None,
            ge=0.001,
            le=1000,
            description="horizontal reach; none: 1.45 times half the narrow side of the "
            "smallest model, so that what stands beside an instance stays outside",
        )
        height_m: float | None = Field(
            None,
            ge=0.001,
            le=1000,
            description="reach below the top; none: 0.7 of the lowest model's height",
        )
        bin_m: float | None = Field(
            None, ge=0.0001, le=100, description="side of a bin; none: 1/8 of the radius"
        )
        model_origin: Literal["typical", "topmost"] = Field(
            "typical",
            description="where on a model its image is taken: typical: at the point of its top "
            "whose image resembles those of the others most; topmost: at its highest point, as in "
            "the paper",
        )
        lift_m: float | None = Field(
            None,
            ge=0,
            le=100,
            description="how far above its point an origin is taken, so that a flat top falls "
            "into the first row; 0 in the paper; none: half a bin",
        )
        noise_m: float | None = Field(
            None,
            ge=0,
            le=100,
            description="noise that the model's image is blurred by; 0 in the paper; none: as "
            "measured",
        )
        outside_weight: float = Field(
            1.0,
            ge=0,
            le=1,
            description="weight of the bins that the model does not reach at their depth: below 1 "
            "for things that stand closer to each other than the radius",
        )
        min_correlation: float | None = Field(
            None,
            gt=0,
            lt=1,
            description="from which an origin is a hit: verification decides; none: 0.6, less "
            "where so few points fall on an instance that their counts differ by chance",
        )
        heights: Literal["model", "any"] = Field(
            "model",
            description="model: only origins as high above the local ground as the top of a model "
            "that stands there; any: every height, as in the paper",
        )
        origins: Origins = Field(
            "voxel",
            description="voxel: one in each voxel first, then every point in and around promising "
            "ones; all: every point; subset: only one in each voxel",
        )
        voxel_m: float | None = Field(
            None, ge=0.001, le=1000, description="side of such a voxel; none: 1/8 of the radius"
        )
        search: Literal["exhaustive", "pruned"] = Field(
            "exhaustive",
            description="exhaustive: the correlation of every origin looked at; pruned: of hits "
            "only, the same ones, without looking at places that provably hold none",
        )

    def run(self, ctx: Context[Config]) -> None:
        """Score every tile's origins, then write the spin images and the hits."""
        sampling = ctx.read_one(SAMPLING)
        models = [shown(model, sampling) for model in ctx.read(MODELS)]
        grid = spin_grid(models, ctx.config)
        lift_m = grid.bin_m / 2 if ctx.config.lift_m is None else ctx.config.lift_m
        noise_m = sampling.noise_m if ctx.config.noise_m is None else ctx.config.noise_m
        places = [_origin(model, grid, lift_m, ctx.config.model_origin) for model in models]
        images = [
            _expected_image(model, grid, place + [0.0, 0.0, lift_m], noise_m, ctx.rng)
            for model, place in zip(models, places, strict=True)
        ]
        weights = None
        if ctx.config.outside_weight < 1:
            weights = [extent_weights(image, ctx.config.outside_weight) for image in images]
        cloud = WorldCloud.of(ctx.read(CLOUD), ctx.read_one(TILES), ctx.read_one(UPRIGHT))
        least = ctx.config.min_correlation or hit_threshold(
            [_points_in(*pair, sampling) for pair in zip(models, images, strict=True)]
        )
        ctx.log(f"hits from a correlation of {least:.2f}")
        bands = None
        if ctx.config.heights == "model":
            bands = HeightBands.of(models, [float(place[2]) for place in places], sampling)
        scan = TileScan(
            cloud=cloud,
            models=tuple(model.name for model in models),
            templates=Templates.of(grid, images, weights),
            bands=bands,
            lift_m=lift_m,
            origins=ctx.config.origins,
            min_correlation=least,
            voxel_m=ctx.config.voxel_m or VOXEL_RADII * grid.radius_m,
            pruned=ctx.config.search == "pruned",
            threads=ctx.threads,
        )
        hits = _HitList(scan.models, least)
        progress = ctx.progress("tiles", len(cloud))
        done = 0
        for scores in ctx.recovered(SCORES):
            hits.add(scores)
            done += 1
            progress.advance()
        if done:
            ctx.log(f"went on from tile {done} of {len(cloud)}")
        for scores in ctx.map(scan, range(done, len(cloud))):
            ctx.write(SCORES, scores)
            hits.add(scores)
            progress.advance()
        found = hits.collect()
        for model, image, place in zip(models, images, places, strict=True):
            ctx.write(SPIN_IMAGES, _image(model.name, "model", grid, image, place, 1.0))
        for best in found:
            if len(best.points):
                ctx.write(SPIN_IMAGES, _scene_image(cloud, best, grid, lift_m))
        for model_hits in found:
            ctx.write(HITS, model_hits)
            ctx.log(f"{len(model_hits.points)} hits of {model_hits.model}")


def spin_grid(models: Sequence[ObjectModel], config: Scan.Config) -> SpinGrid:
    """Extent and bins of the spin images; sizes not stated follow from the smallest model.

    One grid for all models: a point is binned once, however many there are.
    """
    sizes = [model.size for model in models]
    narrow_m = min(float(min(size[0], size[1])) / 2 for size in sizes)
    radius_m = config.radius_m or RADIUS_HALF_WIDTHS * narrow_m
    height_m = config.height_m or HEIGHT_SHARE * min(float(size[2]) for size in sizes)
    try:
        return SpinGrid.of(radius_m, height_m, config.bin_m or radius_m / BINS_ALONG)
    except ValueError as error:
        text = str(error).removeprefix("SpinGrid: ")
        raise StageError(f"{text} (see [scan] radius_m, height_m and bin_m)") from None


def _origin(model: ObjectModel, grid: SpinGrid, lift_m: float, choice: str) -> F64:
    points = model.points.astype(np.float64)
    return typical_point(points, grid, lift_m) if choice == "typical" else topmost_point(points)


def _expected_image(
    model: ObjectModel, grid: SpinGrid, origin: F64, noise_m: float, rng: np.random.Generator
) -> F64:
    """The image that an instance is expected to have: of the model with the scene's noise."""
    points = model.points.astype(np.float64)
    noisy = np.concatenate(
        [points + noise_m * rng.standard_normal(points.shape) for _ in range(BLURS)]
    )
    return object_image(noisy, grid, origin)


def _points_in(model: ObjectModel, image: F64, sampling: Sampling) -> F64:
    """Points in the bins of an instance's image in the scene."""
    share = points_on(model.points, sampling.density) / (BLURS * len(model.points))
    return image * share


def _scene_image(cloud: WorldCloud, hits: Hits, grid: SpinGrid, lift_m: float) -> SpinImage:
    """The scene's image at the best hit."""
    best = int(np.argmax(hits.correlation))
    origin = hits.points[best] + np.array([0.0, 0.0, lift_m])
    reach = np.array([grid.radius_m, grid.radius_m, grid.height_m])
    points = cloud.inside(origin - reach, origin + [grid.radius_m, grid.radius_m, 0.0])
    image = spin_image(points, origin, grid)
    return _image(hits.model, "scene", grid, image, origin, float(hits.correlation[best]))


def _image(
    model: str,
    role: str,
    grid: SpinGrid,
    values: np.ndarray,
    origin: F64,
    correlation: float,
) -> SpinImage:
    return SpinImage(
        model=model,
        role=role,
        radius_m=grid.radius_m,
        height_m=grid.height_m,
        bin_m=grid.bin_m,
        values=values.astype(np.float32),
        origin=vector(origin),
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
