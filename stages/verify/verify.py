"""Stage 6: every candidate is fitted and judged, and keeps the reason for its fate."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Literal

import numpy as np
from pydantic import Field

from spinpipe.schemas import (
    CLOUD,
    CLUSTERS,
    DETECTIONS,
    HYPOTHESES,
    INSTANCES,
    MODELS,
    SAMPLING,
    SCENE,
    SPIN_IMAGES,
    TILES,
    TRACES,
    UPRIGHT,
)
from spinpipe.schemas.poses import InstancePoses
from spinpipe.schemas.records import Detection, FitTrace
from spinpipe.stages.geometry.frames import inverse, rotation_quaternion, world_from_scene
from spinpipe.stages.geometry.world_cloud import WorldCloud
from spinpipe.stages.stage import Context, Progress, Section
from spinpipe.stages.verify.by_evidence import verify_by_evidence
from spinpipe.stages.verify.candidates import Candidates
from spinpipe.stages.verify.decide.verdict import Rules
from spinpipe.stages.verify.icp.verification import IcpRules, verify_by_residual
from spinpipe.stages.verify.judge.search import Store

LOOKS = 2
"""At each candidate, by evidence: see ``judge.search``."""


class Evidence(Section):
    """Of ``method = "evidence"``: which fits are accepted."""

    min_score: float = Field(default=0.5, ge=0, le=1, description="below it: rejected")
    min_observed: float = Field(
        default=0.1, ge=0, le=1, description="least share of the visible surface observed"
    )
    min_margin: float = Field(
        default=0.01,
        ge=0,
        le=1,
        description="least lead in score over another type, or a lesser heading is undecided",
    )
    tolerance_m: float | None = Field(
        default=None,
        gt=0,
        le=100,
        description="how far the surface of an instance may be off at the object's size, as a "
        "standard deviation; none: measured on the candidates",
    )


class Icp(Section):
    """Of ``method = "trimmed"`` and ``"kiss-icp"``: the paper's registration."""

    starts: int = Field(default=12, ge=1, le=360, description="headings to start from")
    iterations: int = Field(default=15, ge=1, le=1000, description="of each start")
    keep: float = Field(default=0.8, gt=0, le=1, description="share of the pairs that count")
    samples: int = Field(default=500, ge=10, le=1_000_000, description="points of the model")
    max_rms_m: float = Field(default=0.115, gt=0, le=100, description="above it: rejected")


class Verify:
    """Fit the model to each candidate's surroundings and decide."""

    name = "verify"
    version = 3
    inputs = (CLOUD, TILES, SCENE, MODELS, UPRIGHT, SAMPLING, SPIN_IMAGES, CLUSTERS)
    outputs = (HYPOTHESES, TRACES, DETECTIONS, INSTANCES)

    class Config(Section):
        """How candidates are fitted and judged."""

        method: Literal["evidence", "trimmed", "kiss-icp"] = Field(
            "evidence",
            description="evidence: registration to convergence, judged by what the scene shows "
            "for and against it; trimmed: the paper's ICP, judged by its residual; kiss-icp: the "
            "same with KISS-ICP's registration",
        )
        evidence: Evidence = Field(default_factory=Evidence)
        icp: Icp = Field(default_factory=Icp)

    def run(self, ctx: Context[Config]) -> None:
        """Fit every candidate, then write traces, detections and the poses of the accepted."""
        upright = ctx.read_one(UPRIGHT)
        candidates = Candidates(
            clusters=list(ctx.read(CLUSTERS)),
            models=list(ctx.read(MODELS)),
            cloud=WorldCloud.of(ctx.read(CLOUD), ctx.read_one(TILES), upright),
            T_scene_world=inverse(world_from_scene(ctx.read_one(SCENE), upright)),
        )
        looks = LOOKS if ctx.config.method == "evidence" else 1
        progress = ctx.progress("candidates", looks * len(candidates.clusters))
        detections: list[Detection] = []
        for detection, trace in _verified(candidates, ctx, progress):
            if trace is not None:
                ctx.write(TRACES, trace)
            detections.append(detection)
        for detection in detections:
            ctx.write(DETECTIONS, detection)
        accepted = [d for d in detections if d.fate == "accepted"]
        positions = np.array([d.position_world for d in accepted]).reshape(-1, 3)
        poses = np.array([d.T_world_object for d in accepted]).reshape(-1, 4, 4)
        ctx.write(INSTANCES, InstancePoses(positions, rotation_quaternion(poses)))
        ctx.log(f"{len(accepted)} of {len(detections)} candidates accepted")


def _verified(
    candidates: Candidates, ctx: Context[Verify.Config], progress: Progress
) -> Iterator[tuple[Detection, FitTrace | None]]:
    config = ctx.config
    if config.method == "evidence":
        store = Store(partial(ctx.write, HYPOTHESES), list(ctx.recovered(HYPOTHESES)))
        if store.recovered:
            first, second = (len(store.of_look(n)) for n in (1, 2))
            ctx.log(f"went on after {first} blocks of the first look, {second} of the second")
        yield from verify_by_evidence(
            candidates,
            ctx.read_one(SAMPLING),
            Rules(**config.evidence.model_dump()),
            ctx.rng,
            threads=ctx.threads,
            map_blocks=ctx.map,
            store=store,
            advance=progress.advance,
            log=ctx.log,
        )
        return
    rules = IcpRules(method=config.method, **config.icp.model_dump())
    images = list(ctx.read(SPIN_IMAGES))
    for result in verify_by_residual(candidates, images, rules, ctx.rng, ctx.threads):
        yield result
        progress.advance()
