"""Stage 5: every candidate is fitted and judged, and keeps the reason for its fate."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from spinpipe.schemas import (
    CLOUD,
    CLUSTERS,
    DETECTIONS,
    INSTANCES,
    MODELS,
    SCENE,
    SPIN_IMAGES,
    TILES,
    TRACES,
    UPRIGHT,
)
from spinpipe.schemas.records import (
    F32,
    F64,
    Cluster,
    Detection,
    FitTrace,
    InstancePoses,
    ObjectModel,
    SpinImage,
    Vector,
)
from spinpipe.stages.frames import heading_deg, inverse, transform, world_from_scene
from spinpipe.stages.icp_fit import IcpFit
from spinpipe.stages.kiss_registration import kiss_icp_fit
from spinpipe.stages.neighbourhood import WorldCloud
from spinpipe.stages.spin_image import topmost_point
from spinpipe.stages.stage import Context, Section
from spinpipe.stages.trimmed_icp import trimmed_icp

MIN_POINTS = 10
"""Fewer scene points say nothing about a pose of four degrees of freedom."""


class Verify:
    """Fits the model to each candidate's surroundings and decides."""

    name = "verify"
    version = 1
    inputs = (CLOUD, TILES, SCENE, MODELS, UPRIGHT, SPIN_IMAGES, CLUSTERS)
    outputs = (TRACES, DETECTIONS, INSTANCES)

    class Config(Section):
        """How candidates are fitted and judged."""

        method: Literal["trimmed", "kiss-icp"] = Field(
            "trimmed", description="registration: the paper's trimmed ICP, or KISS-ICP's"
        )
        starts: int = Field(12, ge=1, le=360, description="headings to start from")
        iterations: int = Field(15, ge=1, le=1000, description="of each start")
        keep: float = Field(0.8, gt=0, le=1, description="share of the pairs that count")
        samples: int = Field(500, ge=10, le=1_000_000, description="points of the model")
        max_rms_m: float = Field(0.115, gt=0, le=100, description="above it: rejected")

    def run(self, ctx: Context[Config]) -> None:
        """Fit every candidate, then write traces, detections and the poses of the accepted."""
        models = {m.name: _Target.of(m, ctx) for m in ctx.read(MODELS)}
        cloud = WorldCloud.of(ctx.read(CLOUD), ctx.read_one(TILES), ctx.read_one(UPRIGHT))
        T_scene_world = inverse(world_from_scene(ctx.read_one(SCENE), ctx.read_one(UPRIGHT)))
        clusters = ctx.read(CLUSTERS)
        progress = ctx.progress("candidates", len(clusters))
        detections: list[Detection] = []
        for cluster in clusters:
            target = models[cluster.model]
            position = np.asarray(cluster.position)
            cutout = target.cut_out(cloud, position)
            fit = target.fit(cutout, position, ctx) if len(cutout) >= MIN_POINTS else None
            if fit is not None:
                ctx.write(TRACES, _trace(cluster, fit))
            judge = _Judge(target, cutout, T_scene_world, ctx.config.max_rms_m)
            detections.append(judge.detection(cluster, fit))
            progress.advance()
        for detection in detections:
            ctx.write(DETECTIONS, detection)
        accepted = [d.T_world_object for d in detections if d.fate == "accepted"]
        poses = np.array(accepted).reshape(-1, 4, 4)
        quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat().reshape(-1, 4)
        ctx.write(INSTANCES, InstancePoses(poses[:, :3, 3], quaternions))
        ctx.log(f"{len(accepted)} of {len(detections)} candidates accepted")


class _Target:
    """A model ready to be fitted: samples of the part that the spin image covers."""

    def __init__(self, model: ObjectModel, image: SpinImage, samples: F64) -> None:
        self.model = model
        self.image = image
        self.samples = samples
        self.top = topmost_point(model.points)
        self.tree = KDTree(model.points.astype(np.float64))

    @classmethod
    def of(cls, model: ObjectModel, ctx: Context[Verify.Config]) -> _Target:
        images = ctx.read(SPIN_IMAGES)
        image = next(i for i in images if i.model == model.name and i.role == "model")
        points = model.points.astype(np.float64)
        within = points[points[:, 2] > points[:, 2].max() - image.height_m]
        rows = ctx.rng.choice(len(within), min(ctx.config.samples, len(within)), replace=False)
        return cls(model, image, within[np.sort(rows)])

    def cut_out(self, cloud: WorldCloud, position: F64) -> F32:
        """Scene points within the spin image's cylinder below the candidate."""
        radius_m, height_m = self.image.radius_m, self.image.height_m
        low = position - [radius_m, radius_m, height_m]
        points = cloud.inside(low, position + [radius_m, radius_m, 0.0])
        near = np.linalg.norm(points[:, :2] - position[:2], axis=1) < radius_m
        return points[near]

    def fit(self, cutout: F32, position: F64, ctx: Context[Verify.Config]) -> IcpFit:
        config = ctx.config
        register = trimmed_icp if config.method == "trimmed" else kiss_icp_fit
        return register(
            self.samples,
            self.top,
            cutout,
            position,
            starts=config.starts,
            iterations=config.iterations,
            keep=config.keep,
            threads=ctx.threads,
        )


class _Judge:
    """Turns a fit into a detection with its fate."""

    def __init__(self, target: _Target, cutout: F32, T_scene_world: F64, max_rms_m: float) -> None:
        self._target = target
        self._cutout = cutout
        self._T_scene_world = T_scene_world
        self._max_rms_m = max_rms_m

    def detection(self, cluster: Cluster, fit: IcpFit | None) -> Detection:
        model = self._target.model
        if fit is None:
            pose = np.eye(4)
            pose[:3, 3] = np.asarray(cluster.position) - self._target.top
            rms_m = runner_rms_m = float("inf")
            inliers, runner_heading, margin = 0, 0.0, 0.0
            coverage = (0.0, 0.0)
        else:
            best, runner = fit.best, fit.runner_up
            pose = fit.poses[-1, best]
            rms_m, inliers = float(fit.rms_m[-1, best]), int(fit.inliers[best])
            runner_rms_m = float(fit.rms_m[-1, runner]) if runner is not None else float("inf")
            runner_heading = heading_deg(fit.poses[-1, runner]) if runner is not None else 0.0
            margin = (runner_rms_m - rms_m) / rms_m if rms_m > 0 else float("inf")
            coverage = self._coverage(pose)
        fate, reason = self._decide(rms_m)
        T_scene_object = self._T_scene_world @ pose
        size = np.ptp(model.points, axis=0)
        return Detection(
            id=cluster.id,
            cluster=cluster.id,
            model=model.name,
            fate=fate,
            reason=reason,
            T_world_object=pose,
            T_scene_model=T_scene_object @ model.T_object_model,
            position_world=_vector(pose[:3, 3]),
            position_scene=_vector(T_scene_object[:3, 3]),
            heading_deg=heading_deg(pose),
            heading_margin=margin,
            correlation=cluster.correlation,
            rms_m=rms_m,
            inliers=inliers,
            runner_up_heading_deg=runner_heading,
            runner_up_rms_m=runner_rms_m,
            coverage_model=coverage[0],
            coverage_scene=coverage[1],
            observed=1.0,
            score=max(0.0, 1.0 - rms_m / (2.0 * self._max_rms_m)),
            size_m=_vector(size),
        )

    def _decide(self, rms_m: float) -> tuple[str, str]:
        if len(self._cutout) < MIN_POINTS:
            return "rejected", f"only {len(self._cutout)} scene points, {MIN_POINTS} needed"
        if rms_m > self._max_rms_m:
            return "rejected", f"rms {rms_m:.3f} m above max_rms_m {self._max_rms_m:g} m"
        return "accepted", f"rms {rms_m:.3f} m within max_rms_m {self._max_rms_m:g} m"

    def _coverage(self, pose: F64) -> tuple[float, float]:
        """Share of model samples near the scene, and of scene points in the model's box near it."""
        reach_m = self._max_rms_m
        moved = transform(pose, self._target.samples)
        scene_tree = KDTree(self._cutout.astype(np.float64))
        by_scene = scene_tree.query(moved, distance_upper_bound=reach_m)[0] < reach_m
        in_object = transform(inverse(pose), self._cutout)
        points = self._target.model.points
        low, high = points.min(axis=0) - reach_m, points.max(axis=0) + reach_m
        inside = in_object[np.all((in_object >= low) & (in_object <= high), axis=1)]
        if len(inside) == 0:
            return float(by_scene.mean()), 0.0
        by_model = self._target.tree.query(inside, distance_upper_bound=reach_m)[0] < reach_m
        return float(by_scene.mean()), float(by_model.mean())


def _trace(cluster: Cluster, fit: IcpFit) -> FitTrace:
    return FitTrace(cluster.id, fit.start_heading_deg, fit.rms_m.T, fit.poses[:, fit.best])


def _vector(values: np.ndarray) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z
