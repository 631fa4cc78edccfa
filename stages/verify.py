"""Stage 5: every candidate is fitted and judged, and keeps the reason for its fate."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field
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
from spinpipe.schemas.records import Detection, FitTrace, InstancePoses
from spinpipe.stages.candidates import Candidates
from spinpipe.stages.frames import inverse, world_from_scene
from spinpipe.stages.icp_verification import IcpRules, verify_by_residual
from spinpipe.stages.neighbourhood import WorldCloud
from spinpipe.stages.stage import Context, Section


class Verify:
    """Fit the model to each candidate's surroundings and decide."""

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
        upright = ctx.read_one(UPRIGHT)
        candidates = Candidates(
            clusters=ctx.read(CLUSTERS),
            models=list(ctx.read(MODELS)),
            cloud=WorldCloud.of(ctx.read(CLOUD), ctx.read_one(TILES), upright),
            T_scene_world=inverse(world_from_scene(ctx.read_one(SCENE), upright)),
        )
        progress = ctx.progress("candidates", len(candidates.clusters))
        detections: list[Detection] = []
        for detection, trace in _verified(candidates, ctx):
            if trace is not None:
                ctx.write(TRACES, trace)
            detections.append(detection)
            progress.advance()
        for detection in detections:
            ctx.write(DETECTIONS, detection)
        accepted = [d.T_world_object for d in detections if d.fate == "accepted"]
        poses = np.array(accepted).reshape(-1, 4, 4)
        quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat().reshape(-1, 4)
        ctx.write(INSTANCES, InstancePoses(poses[:, :3, 3], quaternions))
        ctx.log(f"{len(accepted)} of {len(detections)} candidates accepted")


def _verified(
    candidates: Candidates, ctx: Context[Verify.Config]
) -> Iterator[tuple[Detection, FitTrace | None]]:
    config = ctx.config
    rules = IcpRules(
        method=config.method,
        starts=config.starts,
        iterations=config.iterations,
        keep=config.keep,
        samples=config.samples,
        max_rms_m=config.max_rms_m,
    )
    return verify_by_residual(candidates, list(ctx.read(SPIN_IMAGES)), rules, ctx.rng, ctx.threads)
