"""Right instances of one scene resemble each other: who differs from the group is none of it.

How far surfaces are off is common to all that one reconstruction shows. In a clean scene all right
instances lie close to their surfaces and a decoy that would pass elsewhere stands out; in a wavy
one nobody does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import expit

from spinpipe.schemas.arrays import F64
from spinpipe.stages.verify.judge.examiner import Examiner
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.judge.scoring import PARTS

LOWER = 0.16
"""Quantile one standard deviation below the median of a normal distribution."""
KNOWN = 3.0
"""Instances that tell as much of the spread as ``KNOWN_SPREAD`` does. Chosen."""
KNOWN_SPREAD = 0.2
"""Spread of the logarithm of residual parts before any instance is known: chosen, a little more
than the widest of six labelled scenes has (0.02 to 0.15, measured on their candidates)."""
LEAST_SPREAD = 0.1
"""Of any group: single instances are covered, dark or cut in part. Chosen."""
BELOW_TOP = 2.0
"""Log odds below the median instance at which a candidate counts half as one of the group."""
USUAL = 1.5
"""Spreads below the median that tell nothing: a fifteenth of a normal distribution lies lower."""


def judged_by_group(examiner: Examiner, table: Hypotheses, instances: Hypotheses) -> Hypotheses:
    """The table with the part ``alike`` filled in, and scored again.

    ``alike`` is the likelihood of a residual under the group, exp(-(t - USUAL)^2 / 2), t spreads
    below the median. Median and spread are those of what is as good as most instances are.

    Parameters
    ----------
    table : all hypotheses.
    instances : distinct candidates, one hypothesis each, with their scores.
    """
    if len(instances.model) == 0:
        return table
    residual, alike = PARTS.index("residual"), PARTS.index("alike")
    known = _worth(examiner, instances)[:, residual]
    (usual,) = _quantiles(instances.odds, instances.score, (0.5,))
    weights = expit(instances.odds - usual + BELOW_TOP)
    middle, low = _quantiles(known, weights, (0.5, LOWER))
    count = weights.sum()
    spread = (count * (middle - low) + KNOWN * KNOWN_SPREAD) / (count + KNOWN)
    spread = max(spread, LEAST_SPREAD)
    below = (middle - _worth(examiner, table)[:, residual]) / spread
    parts = table.parts.copy()
    parts[:, alike] = np.exp(-0.5 * np.clip(below - USUAL, 0.0, None) ** 2)
    lost = examiner.log_odds(parts, table.model) - examiner.log_odds(table.parts, table.model)
    return replace(table, parts=parts, odds=table.odds + lost, alone=table.alone + lost)


def _worth(examiner: Examiner, table: Hypotheses) -> F64:
    """(S, len(PARTS)) logarithms of the parts beside those of right instances."""
    return np.log(np.clip(table.parts / examiner.reference[table.model], 1e-9, None))


def _quantiles(values: F64, weights: F64, at: tuple[float, ...]) -> list[float]:
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order]) / weights.sum()
    rows = np.minimum(np.searchsorted(share, at), len(values) - 1)
    return values[order][rows].tolist()
