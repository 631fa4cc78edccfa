"""Verification by evidence: what the scene shows for and against every candidate and model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from spinpipe.schemas.records import Cluster, Detection, FitTrace, ObjectModel, Sampling
from spinpipe.stages.geometry.frames import heading_deg, transform, vector
from spinpipe.stages.geometry.model_surface import model_surface
from spinpipe.stages.geometry.skin import shown
from spinpipe.stages.stage import StageError
from spinpipe.stages.threads import map_threads
from spinpipe.stages.verify.candidates import Candidates
from spinpipe.stages.verify.decide.decision import decide
from spinpipe.stages.verify.decide.verdict import Rules, Verdict
from spinpipe.stages.verify.judge.hypotheses import Course, T_world_object
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.judge.search import MapBlocks, Search, Store
from spinpipe.stages.verify.judge.standards import Standards
from spinpipe.stages.verify.model.field import ModelField, build_model_field
from spinpipe.stages.verify.model.known_object import KnownObject


def verify_by_evidence(
    candidates: Candidates,
    sampling: Sampling,
    rules: Rules,
    rng: np.random.Generator,
    *,
    threads: int,
    map_blocks: MapBlocks,
    store: Store,
    advance: Callable[[int], None],
    log: Callable[[str], None],
) -> Iterator[tuple[Detection, FitTrace | None]]:
    """Try every candidate as every model and decide about all of them together; yields in order.

    Parameters
    ----------
    candidates : what to verify; the model of a cluster is only what proposed it.
    sampling : of the cloud.
    rules : when to accept.
    rng : draws the surface of mesh models.
    threads : of the kernels; never changes a result.
    map_blocks : maps a function over blocks of candidates, in order.
    store : keeps what each block gives.
    advance : told how many more candidates are looked at, each of them twice.
    log : told what was measured.
    """
    if not candidates.clusters:
        return
    names = [model.name for model in candidates.models]
    seeded = list(zip(candidates.models, rng.spawn(len(names)), strict=True))
    fields = map_threads(partial(_field, sampling=sampling), seeded, threads)
    objects = [
        KnownObject(
            model.name, field, model.stretch, "above" if model.visible_from == "above" else "all"
        )
        for field, model in zip(fields, candidates.models, strict=True)
    ]
    clusters = candidates.clusters
    places = np.array([cluster.position for cluster in clusters], np.float64)
    proposed = np.array([names.index(cluster.model) for cluster in clusters])
    search = Search(objects, sampling, candidates.cloud, places, proposed, threads)
    found = search.run(rules.tolerance_m, map_blocks, store, advance)
    for name, error in zip(names, found.standards.error_m, strict=True):
        log(f"surfaces are off by {error:.3f} m at the size of {name}")
    rows_of = found.table.rows_of_candidates(len(places))
    for verdict in decide(found.standards, found.table, places, rules):
        cluster = clusters[verdict.candidate]
        rivals = found.table.rows(rows_of[verdict.candidate])
        courses = found.courses.get(verdict.candidate, [])
        course = next((c for c in courses if np.allclose(c.poses[-1], verdict.pose)), None)
        yield (
            _detection(candidates, verdict, found.standards, rules),
            _trace(cluster, verdict, rivals, course),
        )


def _field(seeded: tuple[ObjectModel, np.random.Generator], sampling: Sampling) -> ModelField:
    model, rng = seeded
    try:
        return build_model_field(model.name, *model_surface(shown(model, sampling), rng))
    except ValueError as error:  # flat, or nothing of it shows from above
        raise StageError(f"{error}; give another model, or [verify] method = 'trimmed'") from None


def _detection(
    candidates: Candidates, verdict: Verdict, standards: Standards, rules: Rules
) -> Detection:
    clusters, model = candidates.clusters, candidates.models[verdict.model]
    cluster = clusters[verdict.candidate]
    pose = T_world_object(verdict.pose, verdict.lean)
    T_scene_object = candidates.T_scene_world @ pose
    evidence = verdict.evidence
    claimed = evidence.get("claimed", 0.0)
    other = candidates.models[verdict.alternative].name if verdict.alternative >= 0 else ""
    return Detection(
        id=cluster.id,
        model=model.name,
        fate=verdict.fate,
        cause=verdict.cause,
        reason=verdict.reason,
        T_world_object=pose,
        T_scene_model=T_scene_object @ model.T_object_model,
        position_world=vector(pose[:3, 3]),
        position_scene=vector(transform(candidates.T_scene_world, pose[None, :3, 3])[0]),
        heading_deg=heading_deg(pose),
        heading_margin=verdict.heading_margin,
        correlation=cluster.correlation,
        rms_m=evidence.get("rms_m", float("inf")),
        inlier_weight=evidence.get("explained", 0.0),
        runner_up_heading_deg=float(np.degrees(verdict.runner_up[3]) % 360.0),
        runner_up_rms_m=verdict.runner_up_rms_m,
        coverage_model=min(evidence.get("supported", 0.0), 1.0),
        coverage_scene=evidence.get("explained", 0.0) / claimed if claimed > 0 else 0.0,
        observed=min(verdict.observed, 1.0),
        score=verdict.score,
        parts=verdict.parts,
        size_m=vector(verdict.size_m),
        alternative=other,
        alternative_margin=verdict.alternative_margin,
        duplicate_of=clusters[verdict.duplicate_of].id if verdict.duplicate_of >= 0 else -1,
        log_odds=verdict.odds,
        tilt_deg=math.degrees(math.atan(math.hypot(*verdict.lean))),
        gate_m=standards.limits[verdict.model].gate_m,
        sharp_m=standards.limits[verdict.model].sharp_m,
        min_score=rules.min_score,
    )


def _trace(
    cluster: Cluster, verdict: Verdict, rivals: Hypotheses, course: Course | None
) -> FitTrace | None:
    """The course of the chosen start, and where every other one with the same model ended."""
    rivals = rivals.rows(rivals.model == verdict.model)
    if len(rivals.model) == 0:
        return None
    ends = rivals.measured("rms_m")
    poses = verdict.pose[None] if course is None else course.poses
    rms_m = np.full((len(ends), len(poses)), np.nan, np.float32)
    rms_m[:, -1] = ends
    if course is not None:
        rms_m[np.argmin(np.abs(rivals.pose - verdict.pose).sum(axis=1))] = course.rms_m
    rms_m[np.isinf(rms_m)] = np.nan
    return FitTrace(
        cluster=cluster.id,
        start_heading_deg=np.degrees(rivals.start[:, 3]) % 360.0,
        rms_m=rms_m,
        poses=np.array([T_world_object(pose, verdict.lean) for pose in poses]),
    )
