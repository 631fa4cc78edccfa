"""Whether one scale stands out among those that were tried, and how well it is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.stage import StageError

STRONG = math.log(10)
"""Log odds of an instance that counts [Jeffreys 1961, appendix B: strong evidence]. At wrong scales
many things fit a little."""
APART = 0.2
"""Factors that differ by more are other answers, not the same peak."""
MOST_RIVAL = 0.5
"""Share of the best one's evidence from which on another factor leaves both in doubt."""
MOST_ERROR = 0.01
"""Relative standard error: two of them are the 2 % that a result is good for."""
_MEDIAN = math.sqrt(math.pi / 2)
"""Standard error of a median over that of a mean."""
_STUDENT = 1.32
"""Of two degrees of freedom, which three sides leave: 68 % lie within so many standard errors."""


@dataclass(frozen=True)
class Trial:
    """What was found with the scene at one scale."""

    factor: float
    """Metres a unit."""
    evidence: float = 0.0
    """Sum of the log odds of the strong instances."""
    instances: int = 0
    estimate: float = 0.0
    """Metres a unit by what the instances stretched by."""
    error: float = math.inf
    """Relative standard error of it."""


@dataclass(frozen=True)
class ScaleFound:
    """The scale that a search ended with."""

    scale: float
    """Metres a unit."""
    note: str


def trial_of(factor: float, stretches: F64, sizes_m: F64, odds: F64) -> Trial:
    """Sum up one trial.

    An instance's scale is the mean of what its sides stretched by: surfaces are off by about as
    many metres on any side, so by least squares a side's logarithm counts with its length squared.
    The estimate is the median of the instances, weighted by their odds: other objects fit badly.
    Its error has two parts: how the instances scatter, and how length, width and height disagree,
    which a wrong model shows however many instances there are.

    Parameters
    ----------
    factor : metres a unit.
    stretches : (N, 3) fitted over stated sizes of the accepted.
    sizes_m : (N, 3) the stated sizes.
    odds : (N,) logarithms of their odds.
    """
    strong = odds >= STRONG
    if not strong.any():
        return Trial(factor)
    sides, odds, logs = sizes_m[strong], odds[strong], np.log(stretches[strong])
    weights = odds / odds.sum()
    squares = (sides**2).sum(axis=1)
    scales = (logs * sides**2).sum(axis=1) / squares
    scale = _weighted_median(scales, weights)
    near = weights * (np.abs(scales - scale) < math.log1p(APART))
    scatter = _weighted_median(np.abs(scales - scale), near) / 0.6745  # [Rousseeuw, Croux 1993]
    off_m = [_weighted_median(side, weights) for side in ((logs - scales[:, None]) * sides).T]
    sides_error = _STUDENT * math.sqrt(float(np.square(off_m).sum()) / 2 / float(weights @ squares))
    error = math.hypot(_MEDIAN * scatter / math.sqrt(len(odds)), sides_error)
    return Trial(factor, float(odds.sum()), len(odds), factor * math.exp(-scale), error)


def peak(trials: Sequence[Trial], best: Trial) -> ScaleFound:
    """Judge whether ``best`` stands out among all trials.

    Raises
    ------
    StageError
        If it does not, or tells the scale no better than a few per cent.
    """
    advice = "state [ingest] scale or scale_from"
    if not best.instances:
        raise StageError(
            f"scale search found nothing from {min(t.factor for t in trials):.2g} to "
            f"{max(t.factor for t in trials):.2g} m a unit; {advice}"
        )
    rivals = [
        t for t in trials if t.instances and apart(t.estimate, best.estimate) > math.log1p(APART)
    ]
    rival = max(rivals, key=lambda t: t.evidence, default=Trial(best.factor))
    if rival.evidence > MOST_RIVAL * best.evidence:
        raise StageError(
            f"scale search found no distinct factor: best {_what(best)}, also {_what(rival)}; "
            + advice
        )
    error = math.hypot(best.error, apart(best.estimate, best.factor))
    if not error <= MOST_ERROR:
        raise StageError(
            f"scale search found {_what(best)}, but uncertain by {error:.1%}: the objects are "
            f"not all like the model; {advice}"
        )
    low, high = half_width(trials, best)
    return ScaleFound(
        best.estimate,
        f"scale {best.estimate:.5g} m a unit (± {error:.1%}), searched: {best.instances} "
        f"instances, evidence {best.evidence:.1f}, half as much at {low:.3g} and {high:.3g}",
    )


def half_width(trials: Sequence[Trial], best: Trial) -> tuple[float, float]:
    """The factors on both sides of the best at which the evidence falls below half of its."""
    ordered = sorted(trials, key=lambda t: t.factor)
    below = [t for t in reversed(ordered) if t.factor < best.factor]
    above = [t for t in ordered if t.factor > best.factor]
    return _half(best, below), _half(best, above)


def _half(best: Trial, outwards: Sequence[Trial]) -> float:
    inner = best
    for outer in outwards:
        if outer.evidence <= best.evidence / 2:
            share = (inner.evidence - best.evidence / 2) / (inner.evidence - outer.evidence)
            return inner.factor * (outer.factor / inner.factor) ** share
        inner = outer
    return inner.factor


def apart(a: float, b: float) -> float:
    """How far apart two factors are, as a logarithm."""
    return abs(math.log(a / b))


def _what(trial: Trial) -> str:
    return f"{trial.estimate:.3g} ({trial.instances} instances, evidence {trial.evidence:.1f})"


def _weighted_median(values: F64, weights: F64) -> float:
    order = np.argsort(values, kind="stable")
    sums = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(sums, sums[-1] / 2)])
