"""Draw how the model was registered to each candidate, step by step.

Candidate 42 is step 42 000 of the timeline ``candidate``, with the pose that was reported; 42 001
and on are the poses of its best start, one an iteration, and the reported one again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from spinpipe.pipeline.drawing import palette
from spinpipe.pipeline.drawing.drawing import CANDIDATE, WORLD, put
from spinpipe.pipeline.drawing.model import (
    hidden,
    model_path,
    model_shape,
    model_tint,
    model_tints,
    pose_of,
)
from spinpipe.pipeline.drawing.timelines import STEPS_A_CANDIDATE, candidate_step
from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import Detection, FitTrace, ObjectModel
from spinpipe.stages.geometry.frames import rotation_quaternion


class Fit(NamedTuple):
    """The steps of one candidate on the timeline ``candidate``."""

    detection: Detection
    trace: FitTrace | None
    poses: F64
    """(P, 4, 4) T_world_object at step i of the candidate; the reported one first and last."""

    @property
    def steps(self) -> list[int]:
        """(P,) on the timeline."""
        return [candidate_step(self.detection.id, i) for i in range(len(self.poses))]


def order_fits(detections: Sequence[Detection], traces: Sequence[FitTrace]) -> list[Fit]:
    """The steps of each candidate."""
    trace_of = {trace.cluster: trace for trace in traces}
    fits: list[Fit] = []
    for detection in detections:
        trace = trace_of.get(detection.id)
        poses = detection.T_world_object.reshape(1, 4, 4)
        if trace is not None:
            walked = trace.poses.reshape(-1, 4, 4)[: STEPS_A_CANDIDATE - 2]
            poses = np.concatenate([poses, walked, poses])
        fits.append(Fit(detection, trace, poses))
    return fits


def draw_shapes(rec: rr.RecordingStream, models: Sequence[ObjectModel]) -> None:
    """Log the models once, out of sight; their poses and colours follow over time."""
    rec.reset_time()
    rec.set_time("stage", sequence=1)
    for model in models:
        path = model_path("verify/fit", model.name)
        put(rec, path, model_shape(model), WORLD, static=True)
        rec.log(path, hidden())


def draw_pose(
    rec: rr.RecordingStream, detection: Detection, models: Mapping[str, ObjectModel]
) -> None:
    """Show one detection's model at the current time, and move the candidate's frame there."""
    rec.log(
        "frames/candidate",
        rr.Transform3D(
            translation=detection.position_world,
            quaternion=rr.Quaternion(xyzw=rotation_quaternion(detection.T_world_object)),
            child_frame=CANDIDATE,
            parent_frame=WORLD,
        ),
    )
    for name, model in models.items():
        path = model_path("verify/fit", name)
        if name != detection.model:
            rec.log(path, hidden())
            continue
        colour = (*palette.fate_colour(detection.fate)[:3], 130)
        rec.log(path, model_tint(model, colour), pose_of(detection.T_world_object))


def draw_fits(
    rec: rr.RecordingStream, fits: Sequence[Fit], models: Mapping[str, ObjectModel]
) -> None:
    """Log the steps of all candidates: models on the way to the reported poses.

    As columns, one call an entity: a scene has thousands of candidates.
    """
    rec.send_columns(
        "frames/candidate",
        indexes=first_steps(fits),
        columns=rr.Transform3D.columns(
            translation=[fit.detection.position_world for fit in fits],
            quaternion=rotation_quaternion(np.array([fit.poses[0] for fit in fits])),
            child_frame=[CANDIDATE] * len(fits),
            parent_frame=[WORLD] * len(fits),
        ),
    )
    for model in models.values():
        _draw_model(rec, fits, model)


def first_steps(fits: Sequence[Fit]) -> list[rr.TimeColumn]:
    """One row a candidate, at its first step."""
    return [rr.TimeColumn("candidate", sequence=[fit.steps[0] for fit in fits])]


def _draw_model(rec: rr.RecordingStream, fits: Sequence[Fit], model: ObjectModel) -> None:
    """Log where one model is at every step: nowhere while another one is fitted."""
    path = model_path("verify/fit", model.name)
    own = [fit for fit in fits if fit.detection.model == model.name]
    if own:
        colours = np.array(
            [(*palette.fate_colour(fit.detection.fate)[:3], 130) for fit in own], np.uint8
        )
        rec.send_columns(path, indexes=first_steps(own), columns=model_tints(model, colours))
    rows: list[tuple[int, F64]] = []
    shown = True  # as the best candidate's, by the row of the stage
    for fit in fits:
        mine = fit.detection.model == model.name
        if mine or shown:
            poses = fit.poses if mine else np.zeros((1, 4, 4))
            rows += list(zip(fit.steps, poses, strict=False))
        shown = mine
    steps, poses = zip(*rows, strict=True)
    T = np.array(poses)
    scales = np.linalg.norm(T[:, :3, :3], axis=1)
    T[~scales.any(axis=1)] = np.eye(4)
    # many times faster than as matrices, which the SDK packs one by one
    columns = rr.InstancePoses3D.columns(
        translations=T[:, :3, 3], quaternions=rotation_quaternion(T), scales=scales
    )
    rec.send_columns(path, indexes=[rr.TimeColumn("candidate", sequence=steps)], columns=columns)
