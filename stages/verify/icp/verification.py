"""Verification as in the paper: the residual of a registration decides [Bovenkamp 2010, 2.4]."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from spinpipe.schemas.arrays import F32, F64
from spinpipe.schemas.records import Cluster, Detection, FitTrace, ObjectModel, SpinImage
from spinpipe.stages.geometry.frames import heading_deg, inverse, transform, vector
from spinpipe.stages.verify.candidates import Candidates
from spinpipe.stages.verify.icp.fit import IcpFit
from spinpipe.stages.verify.icp.kiss import kiss_icp_fit
from spinpipe.stages.verify.icp.trimmed import trimmed_icp

MIN_POINTS = 10
"""Fewer scene points say nothing about a pose of four degrees of freedom."""


@dataclass(frozen=True)
class IcpRules:
    """How candidates are registered and judged."""

    method: str
    """``"trimmed"`` or ``"kiss-icp"``."""
    starts: int
    iterations: int
    keep: float
    samples: int
    max_rms_m: float


def verify_by_residual(
    candidates: Candidates,
    images: list[SpinImage],
    rules: IcpRules,
    rng: np.random.Generator,
    threads: int,
) -> Iterator[tuple[Detection, FitTrace | None]]:
    """Fit every candidate's model to its surroundings; yields them in order.

    Parameters
    ----------
    candidates : what to verify.
    images : spin images of the models, which say how far their surroundings reach.
    rules : see ``IcpRules``.
    rng : draws the samples of each model once.
    threads : of the neighbour search; never changes a result.
    """
    targets = {m.name: _Target.of(m, images, rules, rng) for m in candidates.models}
    for cluster in candidates.clusters:
        target = targets[cluster.model]
        position = np.asarray(cluster.position)
        cutout = target.cut_out(candidates, position)
        fit = None
        if len(cutout) >= MIN_POINTS:
            fit = target.fit(cutout, position, rules, threads)
        judge = _Judge(target, cutout, candidates.T_scene_world, rules.max_rms_m)
        trace = _trace(cluster, fit) if fit is not None else None
        yield judge.detection(cluster, fit), trace


class _Target:
    """A model ready to be fitted: samples of the part that the spin image covers."""

    def __init__(self, model: ObjectModel, image: SpinImage, samples: F64) -> None:
        self.model = model
        self.image = image
        self.samples = samples
        self.top = np.asarray(image.origin)
        self.tree = KDTree(model.points.astype(np.float64))

    @classmethod
    def of(
        cls,
        model: ObjectModel,
        images: list[SpinImage],
        rules: IcpRules,
        rng: np.random.Generator,
    ) -> _Target:
        image = next(i for i in images if i.model == model.name and i.role == "model")
        points = model.points.astype(np.float64)
        within = points[points[:, 2] > points[:, 2].max() - image.height_m]
        rows = rng.choice(len(within), min(rules.samples, len(within)), replace=False)
        return cls(model, image, within[np.sort(rows)])

    def cut_out(self, candidates: Candidates, position: F64) -> F32:
        """Scene points within the spin image's cylinder below the candidate."""
        radius_m, height_m = self.image.radius_m, self.image.height_m
        low = position - [radius_m, radius_m, height_m]
        points = candidates.cloud.inside(low, position + [radius_m, radius_m, 0.0])
        near = np.linalg.norm(points[:, :2] - position[:2], axis=1) < radius_m
        return points[near]

    def fit(self, cutout: F32, position: F64, rules: IcpRules, threads: int) -> IcpFit:
        register = trimmed_icp if rules.method == "trimmed" else kiss_icp_fit
        return register(
            self.samples,
            self.top,
            cutout,
            position,
            starts=rules.starts,
            iterations=rules.iterations,
            keep=rules.keep,
            threads=threads,
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
            pairs, runner_heading, margin = 0, 0.0, 0.0
            coverage = (0.0, 0.0)
        else:
            best, runner = fit.best, fit.runner_up
            pose = fit.poses[-1, best]
            rms_m, pairs = float(fit.rms_m[-1, best]), int(fit.inliers[best])
            runner_rms_m = float(fit.rms_m[-1, runner]) if runner is not None else float("inf")
            runner_heading = heading_deg(fit.poses[-1, runner]) if runner is not None else 0.0
            margin = (runner_rms_m - rms_m) / rms_m if rms_m > 0 else float("inf")
            coverage = self._coverage(pose)
        fate, cause, reason = self._decide(rms_m)
        T_scene_object = self._T_scene_world @ pose
        return Detection(
            id=cluster.id,
            model=model.name,
            fate=fate,
            cause=cause,
            reason=reason,
            T_world_object=pose,
            T_scene_model=T_scene_object @ model.T_object_model,
            position_world=vector(pose[:3, 3]),
            position_scene=vector(T_scene_object[:3, 3]),
            heading_deg=heading_deg(pose),
            heading_margin=margin,
            correlation=cluster.correlation,
            rms_m=rms_m,
            inlier_weight=float(pairs),
            runner_up_heading_deg=runner_heading,
            runner_up_rms_m=runner_rms_m,
            coverage_model=coverage[0],
            coverage_scene=coverage[1],
            observed=1.0,
            score=max(0.0, 1.0 - rms_m / (2.0 * self._max_rms_m)),
            size_m=vector(model.size),
            gate_m=self._max_rms_m,
            sharp_m=self._max_rms_m,
        )

    def _decide(self, rms_m: float) -> tuple[str, str, str]:
        if len(self._cutout) < MIN_POINTS:
            return (
                "rejected",
                "points",
                f"only {len(self._cutout)} scene points, {MIN_POINTS} needed",
            )
        if rms_m > self._max_rms_m:
            return (
                "rejected",
                "residual",
                f"rms {rms_m:.3f} m above max_rms_m {self._max_rms_m:g} m",
            )
        return "accepted", "shown", f"rms {rms_m:.3f} m within max_rms_m {self._max_rms_m:g} m"

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
