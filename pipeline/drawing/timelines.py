"""The timelines of a recording: none of them is time.

- ``stage``: 1 ingest ... 6 verify; what the run knew after that stage,
- ``candidate``: one candidate after the other. Candidate 42 is step 42 000: its verdict, what is
  around it, why; 42 001 and on are the steps of its registration,
- ``threshold``: from 0 to 100, falling from a perfect match: at step s everything is there that
  reaches 1 - s / 100 (hits and candidates by correlation, detections by score),
- ``tile``: origins scored tile by tile; only where there are several tiles.
"""

from __future__ import annotations

STEPS_A_CANDIDATE = 1000
THRESHOLD_STEPS = 100


def candidate_step(candidate: int, step: int = 0) -> int:
    """Place of a candidate, or of a step of its registration, on the timeline ``candidate``."""
    return STEPS_A_CANDIDATE * candidate + min(step, STEPS_A_CANDIDATE - 1)


def threshold_step(value: float) -> int:
    """First step of the timeline ``threshold`` at which something of this value shows."""
    return round(THRESHOLD_STEPS * (1.0 - min(max(value, 0.0), 1.0)))
