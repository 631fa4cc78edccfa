"""What is looked for, when it is accepted, and what became of a candidate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Fate = Literal["accepted", "ambiguous", "rejected"]


@dataclass(frozen=True)
class Rules:
    """When a hypothesis is accepted."""

    min_score: float = 0.5
    min_observed: float = 0.1
    min_margin: float = 0.01
    max_sheltered: float = 0.5


@dataclass(frozen=True, eq=False)
class Verdict:
    """What became of a candidate.

    Attributes
    ----------
    candidate : row of the candidate.
    model : row of the model that explains it best.
    pose : (7,) x, y, z of the base centre, yaw (radians), stretch along the object's axes; world.
    size_m : (3,) fitted extents.
    parts : score parts by name.
    evidence : raw evidence by name.
    score, fate, reason : the decision.
    heading_margin : score minus that of the best other heading of the same model; the score itself
        where the model looks the same from there.
    runner_up : (7,) pose of that other heading.
    runner_up_rms_m : its residual, infinite if there is none.
    alternative, alternative_margin : row of the next best model, -1 if none, and by how much.
    """

    candidate: int
    model: int
    pose: F64
    size_m: F64
    parts: dict[str, float]
    evidence: dict[str, float]
    score: float
    fate: Fate
    reason: str
    heading_margin: float
    runner_up: F64
    runner_up_rms_m: float
    alternative: int
    alternative_margin: float

    @property
    def observed(self) -> float:
        """Share of the model's visible area that the scene says anything about."""
        return self.evidence.get("supported", 0.0) + self.evidence.get("contradicted", 0.0)


def T_world_object(pose: F64) -> F64:
    """(4, 4) of a pose (7,), with the stretch."""
    T = np.eye(4)
    cos, sin = math.cos(pose[3]), math.sin(pose[3])
    T[:3, :3] = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) * pose[4:7]
    T[:3, 3] = pose[:3]
    return T
