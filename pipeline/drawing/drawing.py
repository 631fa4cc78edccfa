"""What the drawings of all stages share: where messages come from, timelines and frames.

A drawing is a pure function from a run's messages to Rerun entities. It computes no results, so a
recording can be rebuilt from the MCAP files at any time.

Entities are named like the stages and topics they show, and live in three named frames: ``local``
and ``world`` as in the messages, and ``candidate``, the object frame of the candidate under the
time cursor. The time cursor stands on timelines that are not time, see ``timelines``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

import rerun as rr

from spinpipe.pipeline.drawing.timelines import candidate_step
from spinpipe.schemas.records import Detection, Upright
from spinpipe.schemas.topics import Topic
from spinpipe.stages import STAGES

T = TypeVar("T")

STAGE_NUMBER = {stage.name: number for number, stage in enumerate(STAGES, 1)}
LOCAL, WORLD, CANDIDATE = "local", "world", "candidate"
NOTES = "notes"
"""One text pane for all: it tells about the stage or the candidate under the time cursor."""


class Reader(Protocol):
    """Gives all messages of a topic of the run, whichever stage wrote them."""

    def __call__(self, topic: Topic[T], /) -> Sequence[T]:
        """Messages in the order in which they were written."""
        ...


def at_stage(rec: rr.RecordingStream, name: str) -> None:
    """Log what follows as a result of stage ``name``.

    A viewer shows an entity only where the active timeline has a row of it, so a result is also
    there from the beginning of the timelines ``candidate`` and ``threshold``.
    """
    rec.reset_time()
    rec.set_time("stage", sequence=STAGE_NUMBER[name])
    rec.set_time("candidate", sequence=0)
    rec.set_time("threshold", sequence=0)


def turn_upright(rec: rr.RecordingStream, upright: Upright) -> None:
    """Log how the local frame stands in the world, from now on."""
    rec.log(
        "frames/local",
        rr.Transform3D(
            translation=upright.translation,
            quaternion=rr.Quaternion(xyzw=upright.quaternion_xyzw),
            child_frame=LOCAL,
            parent_frame=WORLD,
        ),
    )


def at_stages(rec: rr.RecordingStream, path: str, first: str, last: str) -> None:
    """Log what follows below ``path`` as an interim result: shown from one stage to another.

    It is cleared after ``last`` and not on the other timelines, where it would hide the outcome.
    """
    rec.reset_time()
    rec.set_time("stage", sequence=STAGE_NUMBER[last] + 1)
    rec.log(path, rr.Clear(recursive=True))
    rec.set_time("stage", sequence=STAGE_NUMBER[first])


def at_candidate(rec: rr.RecordingStream, candidate: int) -> None:
    """Log what follows for one candidate."""
    rec.reset_time()
    rec.set_time("candidate", sequence=candidate_step(candidate))


def clear_stale(
    rec: rr.RecordingStream, path: str, detections: Sequence[Detection], drawn: set[int]
) -> None:
    """Empty ``path`` at candidates that nothing is drawn for: it would show the one before."""
    left = -1
    for d in sorted(detections, key=lambda d: d.id):
        if d.id not in drawn and left in drawn:
            at_candidate(rec, d.id)
            rec.log(path, rr.Clear(recursive=True))
        left = d.id


def place(rec: rr.RecordingStream, path: str, frame: str) -> None:
    """Say for all times in which frame the coordinates of an entity are.

    Without it, also before its first row, an entity hangs in a frame of its own.
    """
    rec.log(path, rr.CoordinateFrame(frame), static=True)


def put(
    rec: rr.RecordingStream, path: str, shape: rr.AsComponents, frame: str, static: bool = False
) -> None:
    """Log a shape whose coordinates are in ``frame``, now or for all times."""
    if static:
        rec.log(path, rr.CoordinateFrame(frame), shape, static=True)
    else:
        place(rec, path, frame)
        rec.log(path, shape)


def note(rec: rr.RecordingStream, markdown: str) -> None:
    """Put a text in the pane of notes at the current time."""
    rec.log(NOTES, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN))
