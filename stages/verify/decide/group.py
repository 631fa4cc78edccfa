"""Right instances of one scene resemble each other: who differs from the group is none of it.

How far surfaces are off is common to all that one reconstruction shows. In a clean scene all right
instances lie close to their surfaces and a decoy that would pass elsewhere stands out; in a wavy
one nobody does. So is how much of upright surfaces is seen at all: where photos show all sides of
a car, a bush that shows half of them is none; where they show the roofs of buses, nobody knows.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.special import expit

from spinpipe.schemas.arrays import F64
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.judge.scoring import PARTS
from spinpipe.stages.verify.judge.standards import Standards

HIGHER = 0.84
"""Quantile one standard deviation above the median of a normal distribution."""
KNOWN = 3.0
"""Instances that tell as much of the spread as ``KNOWN_SPREAD`` does. Chosen."""
KNOWN_SPREAD = 0.2
"""Spread of the logarithm of residual parts before any instance is known: chosen, a little more
than the widest of six labelled scenes has (0.02 to 0.15, measured on their candidates)."""
LEAST_SPREAD = 0.1
"""Of any group: single instances are covered, dark or cut in part. Chosen."""
GOOD = 0.75
"""Quantile of the log odds, weighted by score: where as many decoys as instances seem to be right,
the median would be a decoy's. Chosen."""
BELOW_TOP = 2.0
"""Log odds below that quantile at which a candidate counts half as one of the group. Chosen."""
USUAL = 1.5
"""Spreads below the median that tell nothing: a fifteenth of a normal distribution lies lower."""
LOWER = 0.16
"""Quantile one standard deviation below the median of a normal distribution."""
KNOWN_SIDES, LEAST_SIDES = 0.12, 0.05
"""Spread of the share of upright surface that is seen of right instances, before any is known and
of any group. Measured on eight labelled scenes: 0.02 to 0.19, half of them 0.08 to 0.14."""
PARTLY_HIDDEN = 0.5
"""Share of right instances of which a neighbour or a tree may hide any part: chosen. In 22 labelled
and artificial scenes 13 of 16 wrong and 7 of 429 right ones go at 0.1, 8 and 3 at 0.5."""
OTHERS_SIDES = (0.55, 0.2)
"""Mean and standard deviation of that share of what else passes by the other parts: of the distinct
wrong candidates with log odds over -3 it is 0.54 and 0.16 in eight labelled cases, 0.69 and 0.17 in
fifteen artificial scenes."""


def judged_by_group(standards: Standards, table: Hypotheses, instances: Hypotheses) -> Hypotheses:
    """The table with the part ``alike`` filled in, and scored again.

    ``alike`` is the likelihood of a residual under the group, exp(-(t - USUAL)^2 / 2), t spreads
    below the median, times the ratio, at most 1, of the likelihoods that a right instance shows no
    more of its sides and that anything else does. Medians and spreads are those of what is as good
    as the better half of what seems to be right; of residuals the spread is that above the median,
    where no decoy reaches.

    Parameters
    ----------
    table : all hypotheses.
    instances : distinct candidates, right or wrong, one hypothesis each, with their scores.
    """
    if len(instances.model) == 0:
        return table
    (good,) = _quantiles(instances.odds, instances.score, (GOOD,))
    weights = expit(instances.odds - good + BELOW_TOP)
    middle, high = _quantiles(_worth(standards, instances), weights, (0.5, HIGHER))
    count = weights.sum()
    spread = (count * (high - middle) + KNOWN * KNOWN_SPREAD) / (count + KNOWN)
    below = (middle - _worth(standards, table)) / max(spread, LEAST_SPREAD)
    parts = table.parts.copy()
    near = np.exp(-0.5 * np.clip(below - USUAL, 0.0, None) ** 2)
    parts[:, PARTS.index("alike")] = near * _shown(table, instances, weights)
    lost = standards.log_odds(parts, table.model) - standards.log_odds(table.parts, table.model)
    return replace(table, parts=parts, odds=table.odds + lost, alone=table.alone + lost)


def _shown(table: Hypotheses, instances: Hypotheses, weights: F64) -> F64:
    """(S,) how much likelier right instances show so much of their sides than others, at most 1."""
    seen = instances.measured("side_supported")
    low, middle = _quantiles(seen, weights, (LOWER, 0.5))
    count = weights.sum()
    spread = (count * (middle - low) + KNOWN * KNOWN_SIDES) / (count + KNOWN)
    seen = table.measured("side_supported")
    right = _density(seen, middle, max(spread, LEAST_SIDES))
    right = (1.0 - PARTLY_HIDDEN) * right + PARTLY_HIDDEN  # hidden by any share
    return np.minimum(right / _density(seen, *OTHERS_SIDES), 1.0)


def _density(values: F64, mean: float, deviation: float) -> F64:
    """Of a normal distribution."""
    t = (values - mean) / deviation
    return np.asarray(np.exp(-0.5 * t * t) / (math.sqrt(2.0 * math.pi) * deviation))


def _worth(standards: Standards, table: Hypotheses) -> F64:
    """(S,) logarithms of the residual parts beside those of right instances."""
    residual = PARTS.index("residual")
    expected = standards.reference[table.model, residual]
    return np.log(np.clip(table.parts[:, residual] / expected, 1e-9, None))


def _quantiles(values: F64, weights: F64, at: tuple[float, ...]) -> list[float]:
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order]) / weights.sum()
    rows = np.minimum(np.searchsorted(share, at), len(values) - 1)
    return values[order][rows].tolist()
