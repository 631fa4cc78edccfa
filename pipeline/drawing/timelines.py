"""The timelines of a recording: none of them is time.

- ``stage``: 1 ingest ... 6 verify; what the run knew after that stage,
- ``candidate``: one candidate after the other. Candidate 42 is step 42 000: its verdict, what is
  around it, why; 42 001 and on are the steps of its registration,
- ``threshold``: from 0 to 100, falling from a perfect match: at step s everything is there that
  reaches 1 - s / 100 (hits and candidates by correlation, detections by score),
- ``tile``: origins scored tile by tile; only where there are several tiles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spinpipe.schemas.arrays import I64

STEPS_A_CANDIDATE = 1000
THRESHOLD_STEPS = 100


def candidate_step(candidate: int, step: int = 0) -> int:
    """Place of a candidate, or of a step of its registration, on the timeline ``candidate``."""
    return STEPS_A_CANDIDATE * candidate + min(step, STEPS_A_CANDIDATE - 1)


def threshold_steps(values: ArrayLike) -> I64:
    """First steps (N,) of the timeline ``threshold`` at which things of values (N,) show."""
    falling = 1.0 - np.clip(np.asarray(values, np.float64), 0.0, 1.0)
    return np.round(THRESHOLD_STEPS * falling).astype(np.int64)
