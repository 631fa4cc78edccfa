"""A small run as messages in memory, and what its recording holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
from rerun.chunk import Chunk, RrdReader

from spinpipe.pipeline.drawing.drawing import STAGE_NUMBER
from spinpipe.pipeline.drawing.recording import (
    close_recording,
    open_recording,
    record_stage,
)
from spinpipe.schemas import (
    CALIBRATIONS,
    CAMERAS,
    CLOUD,
    CLUSTERS,
    DETECTIONS,
    HITS,
    MODELS,
    PLANE,
    SAMPLING,
    SCENE,
    SCORES,
    SPIN_IMAGES,
    TILES,
    TRACES,
    TRAJECTORY,
    UPRIGHT,
)
from spinpipe.schemas.poses import Cameras, Trajectory
from spinpipe.schemas.records import (
    CloudTile,
    Cluster,
    Detection,
    Evidence,
    FitTrace,
    Hits,
    ObjectModel,
    Part,
    Plane,
    Sampling,
    SceneFrame,
    ScoreTile,
    SpinImage,
    TileIndex,
    Upright,
)
from spinpipe.schemas.topics import Topic

ITERATIONS, STARTS = 4, 3
T = TypeVar("T")


STAGES = tuple(STAGE_NUMBER)


FATES = ("accepted", "ambiguous", "rejected")


class Messages:
    """A run held in memory."""

    def __init__(self, of: dict[Topic[Any], list[Any]]) -> None:
        self.of = {topic.name: messages for topic, messages in of.items()}

    def __call__(self, topic: Topic[T], /) -> Sequence[T]:
        return self.of.get(topic.name, [])

    def with_messages(self, topic: Topic[T], messages: Sequence[T]) -> Messages:
        """The same run with other messages on one topic."""
        other = Messages({})
        other.of = {**self.of, topic.name: list(messages)}
        return other


def make_model(name: str, mesh: bool) -> ObjectModel:
    rng = np.random.default_rng(7)
    corners = np.array([[-2, -1, 0], [2, -1, 0], [2, 1, 0], [0, 0, 1.5]], np.float32)
    return ObjectModel(
        name=name,
        points=rng.uniform([-2, -1, 0], [2, 1, 1.5], (300, 3)).astype(np.float32),
        normals=np.zeros((300, 3), np.float32),
        vertices=corners if mesh else np.zeros((0, 3), np.float32),
        faces=np.array([[0, 1, 3], [1, 2, 3]] if mesh else np.zeros((0, 3)), np.int32),
        T_object_model=np.eye(4),
        visible_from="above",
    )


def make_detection(number: int, model: str, fate: str) -> Detection:
    T_world_object = np.eye(4)
    T_world_object[:3, 3] = (number, -number, 0)
    return Detection(
        id=number,
        model=model,
        fate=fate,
        reason=f"{fate} for a reason",
        T_world_object=T_world_object,
        T_scene_model=T_world_object,
        position_world=(float(number), -float(number), 0.0),
        position_scene=(float(number), -float(number), 0.0),
        heading_deg=30.0 * number,
        heading_margin=0.4,
        correlation=0.8,
        rms_m=0.09,
        inlier_weight=400.0,
        runner_up_heading_deg=180.0,
        runner_up_rms_m=0.13,
        coverage_model=0.7,
        coverage_scene=0.6,
        observed=0.9,
        score=0.5 + 0.1 * number,
        parts=(Part("residual", 0.25, 0.8, -3.5), Part("model", 0.9, 0.9, 0.0)),
        gate_m=0.2,
        sharp_m=0.1,
        alternative="van",
        alternative_margin=0.2,
        size_m=(4.0, 2.0, 1.5),
    )


def make_run() -> Messages:
    """Three tiles, a mesh and a cloud as models, a candidate of every fate."""
    rng = np.random.default_rng(1)
    clouds = [
        CloudTile(
            rng.uniform((10 * i, 0, 0), (10 * i + 10, 8, 2), (count, 3)).astype(np.float32),
            rng.integers(0, 255, (count, 3), np.uint8),
        )
        for i, count in enumerate((500, 20, 480))
    ]
    scores = [
        ScoreTile(
            ("saloon", "van"),
            tile.xyz,
            rng.uniform(-1, 1, (len(tile.xyz), 2)).astype(np.float32),
            tile.rgb,
        )
        for tile in clouds
    ]
    image = SpinImage(
        "saloon", "model", 2.5, 1.0, 0.5, np.ones((2, 5), np.float32), (0, 0, 1.5), 1.0
    )
    rms = np.linspace(0.5, 0.1, STARTS * ITERATIONS, dtype=np.float32)
    trace = FitTrace(
        cluster=0,
        start_heading_deg=np.array([0.0, 120.0, 240.0]),
        rms_m=rms.reshape(ITERATIONS, STARTS).T.copy(),
        poses=np.tile(np.eye(4), (ITERATIONS, 1, 1)),
    )
    trace.rms_m[1, 2:] = np.nan
    hits = Hits("saloon", clouds[0].xyz[:30], np.full(30, 0.9, np.float32))
    return Messages(
        {
            SCENE: [SceneFrame((1e6, 2e6, 0.0), (1.0, 1.0, 1.0), 1000, 3, True, "yard.ply")],
            TILES: [
                TileIndex(
                    np.array([tile.xyz.min(axis=0) for tile in clouds]),
                    np.array([tile.xyz.max(axis=0) for tile in clouds]),
                    np.array([len(tile.xyz) for tile in clouds]),
                )
            ],
            CLOUD: clouds,
            CAMERAS: [Cameras(np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)), ("a", "b"))],
            CALIBRATIONS: [],
            TRAJECTORY: [
                Trajectory(
                    np.array([[0.0, 0, 0], [1, 0, 0]]),
                    np.tile([0.0, 0, 0, 1], (2, 1)),
                    np.array([0, 1]),
                )
            ],
            MODELS: [make_model("saloon", mesh=True), make_model("van", mesh=False)],
            PLANE: [Plane((0, 0, 1), 0.0, 900, 1000, 0.03, 0.1, "cameras", (Evidence("c", 1.0),))],
            SAMPLING: [Sampling(0.1, 0.02)],
            UPRIGHT: [Upright((0.6, 0.0, 0.0, 0.8), (0.0, 0.0, 1.0))],
            SCORES: scores,
            HITS: [hits, replace(hits, model="van", points=hits.points[:0])],
            SPIN_IMAGES: [image, replace(image, role="scene", correlation=0.93)],
            CLUSTERS: [Cluster(i, "saloon", (i, 0, 1), 5, 0.8, "delaunay") for i in range(3)],
            TRACES: [trace, replace(trace, cluster=2)],
            DETECTIONS: [
                make_detection(0, "saloon", "accepted"),
                make_detection(1, "van", "ambiguous"),
                make_detection(2, "saloon", "rejected"),
            ],
        }
    )


def draw(path: Path, run: Messages, stages: Sequence[str] = STAGES, points: int = 1000) -> Path:
    rec = open_recording("test", "save", path)
    assert rec is not None
    for stage in stages:
        record_stage(stage, run, rec, points)
    close_recording(rec, path)
    return path


def chunks(path: Path, content: str, static: bool | None = None) -> list[Chunk]:
    """Chunks below a path, in the order in which their first rows were logged."""
    found = RrdReader(path).store().stream().filter(content=content, is_static=static)
    return sorted(found, key=lambda chunk: column([chunk], "rerun.controls.RowId")[0])


def column(found: Sequence[Chunk], name: str) -> list[Any]:
    """All rows of a column, over the chunks that have it."""
    batches = [pa.record_batch(chunk.to_record_batch()) for chunk in found]
    return [row for b in batches if name in b.schema.names for row in b.column(name).to_pylist()]
