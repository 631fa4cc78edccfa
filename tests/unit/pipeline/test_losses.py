"""Which stage lost a labelled object, and what false detections stand on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from spinpipe.pipeline.evaluation.evaluation import score_detections
from spinpipe.pipeline.evaluation.losses import find_intruders, find_losses
from spinpipe.pipeline.evaluation.truth import TruthObject
from spinpipe.schemas import CLUSTERS, HITS, MODELS, SCORES
from spinpipe.schemas.records import Cluster, Detection, Hits, ObjectModel, ScoreTile

RADIUS_M = 1.5


def truth(x: float, model: str = "car") -> TruthObject:
    return TruthObject(2, (x, 0.0), model, (x, 0.0, float("nan")), None, None, False)


def detection(number: int, x: float, fate: str, reason: str = "", model: str = "car") -> Detection:
    pose = np.eye(4)
    return Detection(
        id=number,
        model=model,
        fate=fate,
        reason=reason,
        T_world_object=pose,
        T_scene_model=pose,
        position_world=(x, 0.0, 0.0),
        position_scene=(x, 0.0, 0.0),
        heading_deg=0.0,
        heading_margin=0.0,
        correlation=0.9,
        rms_m=0.05,
        inlier_weight=100.0,
        runner_up_heading_deg=0.0,
        runner_up_rms_m=0.1,
        coverage_model=1.0,
        coverage_scene=1.0,
        observed=1.0,
        score=0.5,
        size_m=(4.0, 2.0, 1.5),
    )


def model(name: str) -> ObjectModel:
    points = np.array([[0, 0, 0], [0, 0, 1.5]], np.float32)
    none = np.empty((0, 3))
    return ObjectModel(name, points, points, none, none.astype(np.int32), np.eye(4), "all")


def messages(hits: list[float], starts: list[float], scored: list[float]) -> Any:
    """A run with hits, candidates and scored origins at these places along x."""

    def along(places: list[float]) -> Any:
        return np.array([[x, 0, 1.5] for x in places], np.float32).reshape(-1, 3)

    content = {
        MODELS.name: [model("car"), model("van")],
        CLUSTERS.name: [
            Cluster(i, "car", (x, 0.0, 1.5), 5, 0.9, "suppression") for i, x in enumerate(starts)
        ],
        HITS.name: [Hits("car", along(hits), np.full(len(hits), 0.9, np.float32))],
        SCORES.name: [
            ScoreTile(
                ("car",),
                along(scored),
                np.full((len(scored), 1), 0.4, np.float32),
                np.zeros((len(scored), 3), np.uint8),
            )
        ],
    }
    return lambda topic: content[topic.name]


@pytest.mark.parametrize(
    ("hits", "start", "found", "stage", "says"),
    [
        ([], None, None, "scan", "best correlation was 0.40"),
        ([0.3, 0.4], None, None, "cluster", "2 hits made no candidate"),
        ([0.3], 0.2, (0.3, "rejected", "score 0.2 below 0.5"), "verify", "score 0.2"),
        (
            [0.3],
            0.2,
            (0.3, "duplicate", "as candidate 7"),
            "resolve",
            "candidate 7",
        ),
        ([0.3], 0.2, (0.3, "ambiguous", "heading"), "verify", "ambiguous: heading"),
        ([0.3], 1.2, (2.5, "accepted", ""), "verify", "ended 2.50 m away"),
        ([0.3], 0.2, (0.3, "accepted", "", "van"), "type", "found as van"),
    ],
)
def test_stage_that_lost_it(
    hits: list[float], start: float | None, found: Any, stage: str, says: str
) -> None:
    truths = [truth(0.0)]
    detections = [detection(0, *found)] if found else []
    score = score_detections(truths, detections, range(len(detections)), RADIUS_M, "name")
    if found and found[1] != "accepted":
        score = score_detections(truths, detections, [], RADIUS_M, "name")
    read = messages(hits, [] if start is None else [start], [0.5])
    (loss,) = find_losses(score, truths, detections, read, RADIUS_M, "name")
    assert loss.stage == stage
    assert says in loss.detail


def test_no_scored_point_near() -> None:
    score = score_detections([truth(0.0)], [], [], RADIUS_M, "any")
    read = messages([], [], [9.0])
    (loss,) = find_losses(score, [truth(0.0)], [], read, RADIUS_M, "any")
    assert (loss.stage, loss.candidate) == ("scan", None)
    assert "no scene point" in loss.detail


def test_candidate_that_another_object_took() -> None:
    truths = [truth(0.0), truth(1.0)]
    detections = [detection(0, 0.9, "accepted")]
    score = score_detections(truths, detections, [0], RADIUS_M, "any")
    read = messages([0.5], [0.5], [0.5])
    (loss,) = find_losses(score, truths, detections, read, RADIUS_M, "any")
    assert loss.truth == 0
    assert "took car in line 2" in loss.detail


def test_kinds_of_false_ones() -> None:
    truths = [truth(0.0), truth(20.0, "van")]
    places = (0.1, 0.4, 1.8, 20.0, 50.0)
    detections = [detection(i, x, "accepted") for i, x in enumerate(places)]
    score = score_detections(truths, detections, range(5), RADIUS_M, "name")
    kinds = [i.kind for i in find_intruders(score, truths, detections, RADIUS_M)]
    assert kinds == ["duplicate", "displaced", "wrong type", "clutter"]
