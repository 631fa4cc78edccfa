"""How far surfaces of this reconstruction are off at the size of an object, measured on candidates.

Neighbouring points agree far better than two reconstructions of one thing: waves, rounded edges and
bridged gaps are common to all points around. What a right instance has to be compared with is the
residual that right instances have, and those of one scene resemble each other.
"""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.judge.resolve import resolve
from spinpipe.stages.verify.judge.standards import Standards
from spinpipe.stages.verify.judge.tolerance import greatest_error_m

QUANTILE = 1 / 3
"""Of the residuals: the median of the right ones where every third that seems right is wrong, since
wrong ones fit worse. Chosen."""
KNOWN = 5.0
"""Instances of a model that tell as much of its error as those of all models together."""


def measured_errors(standards: Standards, best: Hypotheses) -> list[float]:
    """Error of the surface of each model's instances, standard deviation, metres.

    A low weighted quantile of the residuals of distinct candidates, the weights being the
    probabilities that they are instances. What few tell of one model is completed by what all tell.
    """
    best = best.rows(resolve(best.upright, standards.sizes(best), best.odds) < 0)
    rms_m = best.measured("rms_m")
    most = np.array([greatest_error_m(o.field) for o in standards.objects])
    relative = np.sqrt(np.clip(rms_m**2 - standards.sampling.noise_m**2, 0.0, None))
    relative = np.minimum(relative / most[best.model], 1.0)
    pooled = _quantile(np.append(relative, 1.0), np.append(best.score, 1.0))
    errors: list[float] = []
    for m in range(len(standards.objects)):
        own = best.model == m
        weights = np.append(best.score[own], KNOWN)
        errors.append(float(most[m] * _quantile(np.append(relative[own], pooled), weights)))
    return errors


def _quantile(values: F64, weights: F64) -> float:
    order = np.argsort(values)
    share = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(share, QUANTILE * share[-1])])
