"""The ground stage: finds the ground and turns the scene upright."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator
from scipy.spatial.transform import Rotation

from spinpipe.schemas import CAMERAS, CLOUD, PLANE, SAMPLING, TILES, UPRIGHT
from spinpipe.schemas.records import Evidence, Plane, Sampling, Upright
from spinpipe.stages.geometry.sampling import measure_sampling
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.ground.area_sample import AreaSample, sample_by_area
from spinpipe.stages.ground.evidence import SLOPE_DEG, camera_up, solid_surface
from spinpipe.stages.ground.level import lowest_level
from spinpipe.stages.ground.plane import (
    SIGMAS,
    SMOOTHEST,
    FittedPlane,
    LocalPlanes,
    is_collinear,
    ransac_planes,
    refine_plane,
    reliable_local_planes,
)
from spinpipe.stages.ground.sampled_squares import points_of_some_squares
from spinpipe.stages.ground.upright import best_rival, rank, up_quaternion
from spinpipe.stages.stage import Context, Section, StageError

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

PLANES = 6
"""Planes that are tried as the ground."""
FLOOR_DISTANCE = 1e-3
"""Smallest inlier distance, in voxels of the sample: noiseless planes have float32 noise."""
WIDEST_DISTANCE = 0.02
"""Largest inlier distance that is tried when none is stated, as a share of the extent."""
SAMPLING_POINTS = 2_000_000
"""Points that density and noise are measured from."""


class Ground:
    """Estimate the ground plane and the rotation that turns the scene upright."""

    name = "ground"
    version = 3
    inputs = (CLOUD, TILES, CAMERAS)
    outputs = (PLANE, UPRIGHT, SAMPLING)

    class Config(Section):
        """Where up is, or how to find it."""

        up: Literal["auto"] | tuple[float, float, float] = Field(
            "auto", description="'auto', or the up direction [x, y, z] in scene coordinates"
        )
        inlier_distance_m: float | None = Field(
            None, gt=0, description="distance from the ground plane; measured if not stated"
        )
        min_inlier_share: float = Field(
            0.1, gt=0, lt=1, description="smallest share of the surface that a plane may hold"
        )
        min_margin: float = Field(
            2.5, gt=1, description="how much better the evidence for up must be than for its rival"
        )
        confidence: float = Field(
            0.999, gt=0, lt=1, description="probability that RANSAC draws three inliers"
        )
        sample_points: int = Field(
            150_000, ge=1000, le=2_000_000, description="most points in the sample of the surface"
        )

        @field_validator("up")
        @classmethod
        def _not_zero(cls, up: str | tuple[float, float, float]) -> object:
            if not isinstance(up, str) and not any(up):
                raise ValueError("up must not be [0, 0, 0]")
            return up

    def run(self, ctx: Context[Config]) -> None:
        """Sample the cloud, find the ground, write its plane and the upright rotation."""
        sample = _sample(ctx)
        points = sample.points.astype(np.float64)
        local = reliable_local_planes(points)
        if ctx.config.up == "auto":
            plane = _estimate(ctx, points, local, sample.voxel)
        else:
            plane = _stated(ctx, points, local, sample.voxel)
        up = np.array(plane.normal)
        ctx.write(PLANE, plane)
        upright = Upright(up_quaternion(up), (0.0, 0.0, plane.offset))
        ctx.write(UPRIGHT, upright)
        sampling = _measure_sampling(ctx, upright)
        ctx.write(SAMPLING, sampling)
        share = plane.inliers / plane.points
        ctx.log(f"up is {format_vector(up)} in scene axes (from {plane.up_source})")
        ctx.log(f"ground rms {plane.rms_m:.3f} m, {share:.0%} of the surface")
        ctx.log(f"points {sampling.spacing_m:.3f} m apart, noise {sampling.noise_m:.3f} m")


def _sample(ctx: Context[Ground.Config]) -> AreaSample:
    index = ctx.read_one(TILES)
    total = int(index.counts.sum())
    if total == 0:
        raise StageError("ground: the cloud is empty; check the input of [ingest]")
    cloud = ctx.read(CLOUD)
    progress = ctx.progress("points", total)

    def tiles() -> Iterator[F32]:
        for tile in cloud:
            yield tile.xyz
            progress.advance(len(tile.xyz))

    extent = float((index.high.max(axis=0) - index.low.min(axis=0)).max())
    sample = sample_by_area(tiles(), extent, ctx.config.sample_points)
    if len(np.unique(sample.points, axis=0)) < 3:
        raise StageError("ground: fewer than three distinct points; the scene needs a surface")
    if is_collinear(sample.points.astype(np.float64)):
        raise StageError("ground: all points lie on one line; the scene needs a surface")
    return sample


def _measure_sampling(ctx: Context[Ground.Config], upright: Upright) -> Sampling:
    index = ctx.read_one(TILES)
    cloud = WorldCloud.of(ctx.read(CLOUD), index, upright)
    diagonal_m = float(np.linalg.norm(index.high.max(axis=0) - index.low.min(axis=0)))
    points = points_of_some_squares(cloud, diagonal_m, SAMPLING_POINTS)
    try:
        return measure_sampling(points)
    except ValueError as error:
        raise StageError(f"ground: {error}; the scene needs more points") from None


def _estimate(ctx: Context[Ground.Config], points: F64, local: LocalPlanes, voxel: float) -> Plane:
    """Choose the plane and the side that the evidence speaks for."""
    config = ctx.config
    distance = inlier_distance(config, local, voxel)
    planes = find_planes(config, points, local.normals, distance, ctx.rng)
    cameras = None
    for message in ctx.read(CAMERAS):
        rotations = Rotation.from_quat(message.quaternions_xyzw).as_matrix()
        cameras = (message.positions, rotations)
    surface = solid_surface(points, local.normals, voxel)
    hypotheses = rank(surface, planes, cameras)
    if not hypotheses:
        raise StageError(
            f"ground: no plane holds {config.min_inlier_share:.0%} of the surface; set"
            " ground.up = [x, y, z], or raise ground.inlier_distance_m"
        )
    best, rival = hypotheses[0], best_rival(hypotheses)
    vertical = None if cameras is None else camera_up(cameras[1])
    if vertical is not None and best.evidence["cameras level"] < 0:
        # The best plane is a wall to the cameras: the scene has no ground, or too little of it.
        raise _undecided(vertical, best.up)
    if best.score < config.min_margin * rival.score:
        raise _undecided(best.up, rival.up)
    by_points = best.weight("points") / rival.weight("points")
    by_cameras = best.weight("cameras") / rival.weight("cameras")
    plane = refine_plane(
        surface.points[best.terrain.members],
        best.terrain.plane,
        window=np.inf,
        widest=np.inf,
        fixed_distance=config.inlier_distance_m is not None,
    )
    return to_record(
        plane,
        points,
        "cameras" if by_cameras > by_points else "points",
        {**best.evidence, "margin": best.score / rival.score},
    )


def _undecided(first: F64, second: F64) -> StageError:
    return StageError(
        "ground: cannot tell which way is up: candidates"
        f" {format_vector(first)} and {format_vector(second)};"
        f" set ground.up = {format_vector(first)} (or the other) in the config"
    )


def _stated(ctx: Context[Ground.Config], points: F64, local: LocalPlanes, voxel: float) -> Plane:
    """Keep the stated direction and find the height of the ground along it."""
    up = np.array(ctx.config.up, np.float64)
    up /= np.linalg.norm(up)
    distance = inlier_distance(ctx.config, local, voxel)
    planes = find_planes(ctx.config, points, local.normals, distance, ctx.rng)
    lying = [plane for plane in planes if abs(plane.normal @ up) > np.cos(np.radians(SLOPE_DEG))]
    surface = solid_surface(points, local.normals, voxel)
    hypotheses = [h for h in rank(surface, lying, None) if h.up @ up > 0]
    if hypotheses:
        ground = hypotheses[0].terrain
        level = float(np.median(surface.points[ground.members] @ up))
        distance = ground.plane.inlier_distance
    else:
        level = lowest_level(points, up, voxel, distance)
    return to_record(FittedPlane(up, -level, distance), points, "config", {})


def inlier_distance(config: Ground.Config, local: LocalPlanes, voxel: float) -> float:
    """Derive the inlier distance from the noise of the smoothest surfaces unless it is stated.

    Rougher ground is reached by widening; clutter must not widen it from the start.
    """
    if config.inlier_distance_m is not None:
        return config.inlier_distance_m
    noise = float(np.quantile(local.deviations, SMOOTHEST))
    return max(SIGMAS * noise, FLOOR_DISTANCE * voxel)


def find_planes(
    config: Ground.Config, points: F64, normals: F64, distance: float, rng: np.random.Generator
) -> list[FittedPlane]:
    """Find the largest planes, with an inlier distance as small as the scene allows.

    Where none is stated it starts at the noise of the surface and doubles until a plane is found:
    natural ground is rougher at large than it is locally.
    """
    centre = np.median(points, axis=0)
    centred = points - centre
    low, high = np.quantile(centred, (0.05, 0.95), axis=0)
    widest = WIDEST_DISTANCE * float(np.linalg.norm(high - low))
    stated = config.inlier_distance_m is not None
    while True:
        planes = ransac_planes(
            centred,
            normals,
            distance,
            rng,
            count=PLANES,
            min_share=config.min_inlier_share,
            confidence=config.confidence,
            fixed_distance=stated,
        )
        if planes or stated or 2 * distance > widest:
            break
        distance *= 2
    return [
        FittedPlane(p.normal, p.offset - float(p.normal @ centre), p.inlier_distance)
        for p in planes
    ]


def to_record(plane: FittedPlane, points: F64, source: str, evidence: dict[str, float]) -> Plane:
    """Describe a plane with its inliers among the sample."""
    heights = plane.heights(points)
    inliers = heights[np.abs(heights) < plane.inlier_distance]
    x, y, z = plane.normal
    return Plane(
        normal=(float(x), float(y), float(z)),
        offset=plane.offset,
        inliers=len(inliers),
        points=len(points),
        rms_m=float(np.sqrt(np.mean(inliers**2))) if len(inliers) else 0.0,
        inlier_distance_m=plane.inlier_distance,
        up_source=source,
        evidence=tuple(Evidence(name, float(value)) for name, value in evidence.items()),
    )


def format_vector(vector: F64) -> str:
    """Write a unit vector as it stands in the config."""
    return "[" + ", ".join(f"{v + 0.0:.4f}" for v in vector) + "]"
