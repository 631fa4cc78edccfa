"""What is looked for, when it is accepted, and what became of a candidate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import Part

Fate = Literal["accepted", "ambiguous", "duplicate", "rejected"]
Cause = Literal[
    "shown", "score", "observed", "sheltered", "continues", "type", "duplicate", "nothing"
]
"""What decided: enough of it is shown; the score; too little observed; it lies below something
else; a body goes on beyond it; two models fit alike; another one stands there; no surface."""


@dataclass(frozen=True)
class Rules:
    """When a hypothesis is accepted."""

    min_score: float = 0.5
    min_observed: float = 0.1
    min_margin: float = 0.01
    max_sheltered: float = 0.5
    min_reconstructed: float = 0.6
    """Of what a model that is visible from above shows: of a thing that the border cuts in half
    nobody knows how it goes on. Chosen: instances that lack a third have 0.61 or more."""
    tolerance_m: float | None = None
    """How far surfaces of instances are off, a standard deviation; None: measured."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """What became of a candidate.

    Attributes
    ----------
    candidate : row of the candidate.
    model : row of the model that explains it best.
    pose : (7,) x, y, z of the base centre, yaw (radians), stretch along the object's axes; world.
    lean : (2,) slopes of what it stands on, along the world's x and y.
    size_m : (3,) fitted extents.
    parts : of the score, beside what a right instance gets; none where nothing stands.
    evidence : raw evidence by name.
    odds, score : logarithm of the odds that it is an instance, and that as a probability.
    fate, cause, reason : the decision.
    duplicate_of : row of the candidate that stands in the same place, -1 if none.
    heading_margin : score minus that of the best other heading of the same model; the score itself
        where the model looks the same from there.
    runner_up : (7,) pose of that other heading.
    runner_up_rms_m : its residual, infinite if there is none.
    alternative, alternative_margin : row of the next best model, -1 if none, and by how much.
    """

    candidate: int
    model: int
    pose: F64
    lean: F64
    size_m: F64
    parts: tuple[Part, ...]
    evidence: dict[str, float]
    odds: float
    score: float
    fate: Fate
    cause: Cause
    reason: str
    duplicate_of: int
    heading_margin: float
    runner_up: F64
    runner_up_rms_m: float
    alternative: int
    alternative_margin: float

    @property
    def observed(self) -> float:
        """Share of the model's visible area that the scene says anything about."""
        return self.evidence.get("supported", 0.0) + self.evidence.get("contradicted", 0.0)
