"""The ground stage: finds the ground and turns the scene upright."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field, field_validator
from scipy.spatial.transform import Rotation

from spinpipe.schemas import CAMERAS, CLOUD, PLANE, SAMPLING, SCENE, TILES, TRAJECTORY, UPRIGHT
from spinpipe.schemas.arrays import F32, F64, Mask
from spinpipe.schemas.poses import Trajectory
from spinpipe.schemas.records import Evidence, Level, Plane, Sampling, SceneFrame, Upright
from spinpipe.stages.geometry.sampling import measure_sampling
from spinpipe.stages.geometry.skin import blur_of
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.ground.area_sample import AreaSample, sample_by_area
from spinpipe.stages.ground.evidence import Surface, Terrain, camera_up, solid_surface
from spinpipe.stages.ground.level import NOTABLE, lowest_level
from spinpipe.stages.ground.patches import flat_patches
from spinpipe.stages.ground.plane import is_collinear, reliable_local_planes
from spinpipe.stages.ground.sampled_squares import points_of_some_squares
from spinpipe.stages.ground.surfaces import SIGMAS, Surfaces, scene_surfaces
from spinpipe.stages.ground.upright import (
    SAME_DIRECTION_DEG,
    Hypothesis,
    best_rival,
    rank,
    up_quaternion,
)
from spinpipe.stages.ground.vertical import Vertical, Witnesses
from spinpipe.stages.stage import Context, Section, StageError

SMALL = 0.02
"""A ground that holds a smaller share of the surface is perhaps none."""
_COARSEST = 4.0
"""Steps of the coordinates, in spacings, from which the largest planes are those of the steps."""
SAMPLING_POINTS = 2_000_000
"""Points that density and noise are measured from."""


class Ground:
    """Estimate the ground plane and the rotation that turns the scene upright."""

    name = "ground"
    version = 4
    inputs = (CLOUD, TILES, SCENE, CAMERAS, TRAJECTORY)
    outputs = (PLANE, UPRIGHT, SAMPLING)

    class Config(Section):
        """Where up is, or how to find it."""

        up: Literal["auto"] | tuple[float, float, float] = Field(
            "auto", description="'auto', or the up direction [x, y, z] in scene coordinates"
        )
        min_margin: float = Field(
            2.5,
            gt=1,
            le=1e6,
            description="how much better the evidence for up must be than for its rival",
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
        scene = _Scene.of(_sample(ctx))
        declared, stated = ctx.read_one(SCENE).up, ctx.config.up
        if stated != "auto":
            plane = _along(scene, np.array(stated, np.float64), "config")
        elif declared:
            plane = _along(scene, np.array(declared, np.float64), "file")
        else:
            _require_fine(ctx.read_one(SCENE))
            plane = _estimate(ctx, scene)
        up = np.array(plane.normal)
        ctx.write(PLANE, plane)
        upright = Upright(up_quaternion(up), (0.0, 0.0, plane.offset))
        ctx.write(UPRIGHT, upright)
        sampling = _measure_sampling(ctx, upright)
        ctx.write(SAMPLING, sampling)
        share = plane.inliers / plane.points
        ctx.log(f"up is {format_vector(up)} in scene axes (from {plane.up_source})")
        if plane.evidence:
            ctx.log("for it " + ", ".join(f"{e.name} {e.value:+.2f}" for e in plane.evidence))
        ctx.log(f"ground rms {plane.rms_m:.3f} m, {share:.0%} of the surface{levels_text(plane)}")
        if share < SMALL:
            ctx.log(
                "odd: next to nothing of the scene is ground: perhaps up is another; look at the "
                "recording, state [ground] up"
            )
        ctx.log(
            f"points {sampling.spacing_m:.3f} m apart, noise {sampling.noise_m:.3f} m"
            f"{errors_text(sampling)}"
        )
        if sampling.blur_m > 0:
            ctx.log(f"a skin: steps are blurred by {sampling.blur_m:.3f} m, drawings are draped")


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
        sampling = measure_sampling(points)
    except ValueError as error:
        raise StageError(f"ground: {error}; the scene needs more points") from None
    return replace(sampling, blur_m=blur_of(points.astype(np.float64), sampling.spacing_m))


class _Scene(NamedTuple):
    """What the scene's surface looks like."""

    surface: Surface
    surfaces: Surfaces

    @classmethod
    def of(cls, sample: AreaSample) -> _Scene:
        points = sample.points.astype(np.float64)
        surfaces = scene_surfaces(flat_patches(points, sample.voxel), len(points))
        normals = reliable_local_planes(points).normals
        return cls(solid_surface(points, normals, sample.voxel), surfaces)


def _require_fine(scene: SceneFrame) -> None:
    """Stop where the steps of the coordinates make planes of their own, which hold more points."""
    if scene.step_m > _COARSEST * scene.spacing_m > 0:
        raise StageError(
            "ground: cannot tell which way is up: coordinates come in steps of "
            f"{scene.step_m:.2g} m, {scene.step_m / scene.spacing_m:.0f} times as far as points "
            "are apart; export them as double, with an offset, or set ground.up = [x, y, z]"
        )


def _estimate(ctx: Context[Ground.Config], scene: _Scene) -> Plane:
    """Choose the vertical and the end of it that the evidence speaks for."""
    cameras, vertical = None, None
    for message in ctx.read(CAMERAS):
        rotations = Rotation.from_quat(message.quaternions_xyzw).as_matrix()
        cameras, vertical = (message.positions, rotations), camera_up(rotations)
    also = np.empty((0, 3)) if vertical is None else vertical[None]
    hypotheses: list[Hypothesis] = []
    if len(scene.surfaces):
        verticals = Witnesses.of(scene.surfaces).verticals(also)
        hypotheses = rank(scene.surface, scene.surfaces, verticals, cameras)
    lidar = next((_lidar_up(path) for path in ctx.read(TRAJECTORY)), None)
    if lidar is not None:
        decided = _is_clear(hypotheses, ctx.config.min_margin)
        if decided and hypotheses[0].up @ lidar < np.cos(np.radians(SAME_DIRECTION_DEG)):
            raise _undecided(lidar, hypotheses[0].up)
        if not decided:
            return _along(scene, lidar, "lidar")
    if not hypotheses:
        raise StageError(
            "ground: cannot tell which way is up: the scene has no level surface;"
            " set ground.up = [x, y, z]"
        )
    best, rival = hypotheses[0], best_rival(hypotheses)
    if vertical is not None and best.evidence["cameras level"] < 0:
        # The best plane is a wall to the cameras: the scene has no ground, or too little of it.
        raise _undecided(vertical, best.up)
    if not _is_clear(hypotheses, ctx.config.min_margin):
        raise _undecided(best.up, rival.up)
    by_points = best.weight("points") / rival.weight("points")
    by_cameras = best.weight("cameras") / rival.weight("cameras")
    return to_record(
        scene,
        best.up,
        best.terrain,
        "cameras" if cameras is not None and by_cameras > by_points else "points",
        {**best.evidence, "margin": best.score / rival.score},
    )


def _is_clear(hypotheses: list[Hypothesis], margin: float) -> bool:
    return bool(hypotheses) and (hypotheses[0].score >= margin * best_rival(hypotheses).score)


def _lidar_up(path: Trajectory) -> F64:
    """Mean z axis of a lidar, which is up by convention [ROS REP 103], local frame."""
    z = Rotation.from_quat(path.quaternions_xyzw).apply([0.0, 0.0, 1.0]).mean(axis=0)
    return z / np.linalg.norm(z)


def _undecided(first: F64, second: F64) -> StageError:
    return StageError(
        "ground: cannot tell which way is up: candidates"
        f" {format_vector(first)} and {format_vector(second)};"
        f" set ground.up = {format_vector(first)} (or the other) in the config"
    )


def _along(scene: _Scene, up: F64, source: str) -> Plane:
    """Keep the direction that the user or the file's format states, and find the ground along it.

    Formats that define their z as height (LAS with its coordinate system) are not asked twice: in
    small or sparse clouds the points are the weaker witness.
    """
    up = up / np.abs(up).max()  # the squares of very small or large numbers are 0 or infinite
    up = up / np.linalg.norm(up)
    hypotheses = rank(scene.surface, scene.surfaces, [Vertical(up, np.inf)], None)
    terrain = next((h.terrain for h in hypotheses if h.up @ up > 0), None)
    return to_record(scene, up, terrain, source, {})


def to_record(
    scene: _Scene, up: F64, terrain: Terrain | None, source: str, evidence: dict[str, float]
) -> Plane:
    """Describe the ground: its level plane, and how much of the scene's surface it is."""
    points, voxel = scene.surface.points, scene.surface.voxel
    if terrain is None:
        distance = SIGMAS * voxel
        level, levels = lowest_level(points, up, voxel, distance), ()
        members = np.abs(points @ up - level) < distance
    else:
        distance, members = terrain.plane.inlier_distance, terrain.members
        level, levels = _levels(scene.surface, members, up, distance)
    x, y, z = up.tolist()
    return Plane(
        normal=(x, y, z),
        offset=-level,
        inliers=int(np.count_nonzero(members)),
        points=len(points),
        rms_m=distance / SIGMAS,
        inlier_distance_m=distance,
        up_source=source,
        evidence=tuple(Evidence(name, float(value)) for name, value in evidence.items()),
        levels=levels,
    )


def _levels(
    surface: Surface, members: Mask, up: F64, distance: float
) -> tuple[float, tuple[Level, ...]]:
    """Height of the lowest piece of the ground that is not small, and of all such above it.

    Connected pieces count with their median height; those within ``distance`` are one level.
    """
    labels, heights = surface.groups(members), surface.points[members] @ up
    sizes = np.bincount(labels)
    notable = np.flatnonzero(sizes >= NOTABLE * sizes.max())
    medians = np.array([np.median(heights[labels == piece]) for piece in notable])
    order = np.argsort(medians, kind="stable")
    medians, shares = medians[order], sizes[notable][order] / len(surface.points)
    first = np.flatnonzero(np.diff(medians, prepend=-np.inf) > distance)
    weights = np.add.reduceat(shares, first)
    middle = np.add.reduceat(shares * (medians - medians[0]), first) / weights
    levels = zip(middle.tolist(), weights.tolist(), strict=True)
    least = NOTABLE * float(weights.max())
    return float(medians[0]), tuple(Level(h, share) for h, share in levels if share >= least)


def levels_text(plane: Plane) -> str:
    """The levels of the ground where there are several."""
    if len(plane.levels) < 2:
        return ""
    return ", at " + ", ".join(f"{v.height_m:.1f} m ({v.share:.0%})" for v in plane.levels)


def errors_text(sampling: Sampling) -> str:
    """The error over patches larger than those of the noise."""
    errors = sampling.errors[1:]
    if not errors:
        return ""
    return ", error " + ", ".join(f"{e.error_m:.3f} over {e.side_m:.2g} m" for e in errors)


def format_vector(vector: F64) -> str:
    """Write a unit vector as it stands in the config."""
    return "[" + ", ".join(f"{v + 0.0:.4f}" for v in vector) + "]"
