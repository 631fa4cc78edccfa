"""From evidence to a score: named parts in 0..1, each with a meaning, and how they are weighed.

A part is the share of what it looks at that speaks for the hypothesis. What chance alone would
give is taken off, so 0 means "no better than points strewn at random".
"""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.judge.tolerance import Tolerance

PARTS = ("model", "sides", "scene", "residual", "outline", "stands", "alike")
"""model: visible surface of the model that the scene shows, against what the scene contradicts.
sides: the same for upright surfaces, as far as they can be judged.
scene: points in the model's bounding box that lie on its surface, beyond chance; in noise that
swallows the shape, how many there are.
residual: how much closer they lie than chance would put them.
outline: how far the scene drops where the model ends.
stands: whether the base is at the local ground, and that around the outline.
alike: whether its residual is one that instances of this scene have, see ``decide.group``; 1 until
all candidates are known."""

HIDDEN = 0.5
"""Weight of surface below something else: less than what is seen through, more than nothing."""
SWALLOWED = 0.6
"""Credit for surface without any return, where ground is seen all around: dark paint and glass."""
UNJUDGED_SIDES = 0.3
"""Support, as a share of the sides, that they have before any is seen: they are believed in."""
STANDS = 0.125
"""How far off the ground a base may be, as a share of the height: kerbs, slopes, cut models."""
SWALLOWS_SHAPE = 8
"""Power of the share of the box that the gate fills: below two thirds of it shapes still show."""
WORTHLESS = 1e-3
"""Part from which less makes no difference."""
SURPLUS_SHARE = 0.1
"""Merit of being better than a right instance usually is: enough to choose between headings."""
POWERS = (8.0, 5.0, 1.5, 5.0, 13.0, 5.0, 1.0)
"""Of the parts: how much a share of what a right instance shows is worth, in log odds.

Rounded from a logistic regression with weights of at least 0 over the distinct candidates of eight
labelled cases of six scenes, each with equal weight, as many right as wrong ones; a scene that is
left out is judged as well by what the others say (docs/verification.md). Rounded towards each other
where parts tell much the same: outline, model and sides less, residual more; scene, which tells
next to nothing there, is kept for decoys of artificial scenes. alike is a likelihood already.
"""
ODDS = 5.2
"""Logarithm of the odds that what is as good as a right instance is one; measured likewise."""


def score_parts(
    evidence: F64,
    limits: Tolerance,
    shell_share: float,
    expected: float,
    above_ground_m: F64,
    height_m: F64,
) -> F64:
    """Named parts of each hypothesis.

    Parameters
    ----------
    evidence : (S, len(EVIDENCE)), see ``hypotheses.refine_poses``.
    limits : of the model.
    shell_share : what chance explains, see ``tolerance.shell_share``.
    expected : points that a right, fully seen instance explains; 0 if not known.
    above_ground_m : (S,) height of the base above the local ground.
    height_m : (S,) height of the fitted model.

    Returns
    -------
    (S, len(PARTS)) float64, each 0..1.
    """
    column = {name: evidence[:, k] for k, name in enumerate(EVIDENCE)}
    swallowed = SWALLOWED * column["drop"] * column["ring"] * column["empty"]
    by_chance = column["contradicted"] * limits.chance / (1.0 - limits.chance)
    shown = np.clip(column["supported"] - by_chance, 0.0, None) + swallowed
    asked = column["supported"] + column["contradicted"] + column["empty"]
    asked = asked + HIDDEN * column["covered"]
    model = np.divide(shown, asked, out=np.zeros_like(shown), where=asked > 0)
    sides = column["side_supported"] + UNJUDGED_SIDES
    sides = sides / (sides + column["side_contradicted"])
    claimed = column["claimed"]
    share = np.divide(column["explained"], claimed, out=np.zeros_like(shown), where=claimed > 0)
    # a gate as wide as the body leaves nothing that could be told from chance
    scene = np.clip((share - shell_share) / max(1.0 - shell_share, 1e-9), 0.0, 1.0)
    # the more of the box the gate fills, the more it is only the number of points that tells
    if expected > 0:
        number = np.clip(column["explained"] / expected, WORTHLESS, 1.0)
        scene = scene * number ** (shell_share**SWALLOWS_SHAPE)
    # uniform over the gate, residuals have a standard deviation of gate / sqrt(3)
    residual = 1.0 - np.minimum(3.0 * (column["rms_m"] / limits.gate_m) ** 2, 1.0)
    # many points make the ground, so its height is known much better than the noise of one
    # what is higher than the model may be stretched leaves its base in the air
    off = np.abs(above_ground_m) / ((STANDS + limits.stretch / 2) * height_m)
    stands = np.clip(2.0 - off, 0.0, 1.0)
    stands = stands * column["grounded"]
    outline, alike = np.cbrt(column["drop"]), np.ones_like(shown)
    return np.stack([model, sides, scene, residual, outline, stands, alike], axis=1)


def log_odds(parts: F64, reference: F64) -> F64:
    """Log odds (S,) that hypotheses are instances: the sum of the merits of all parts.

    Arguments as of ``merits``.
    """
    return ODDS + merits(parts, reference).sum(axis=1)


def merits(parts: F64, reference: F64) -> F64:
    """What each part (S, len(PARTS)) adds to the logarithm of the odds; mostly negative.

    Parameters
    ----------
    parts : (S, len(PARTS))
    reference : (S, len(PARTS)) parts of a right instance, see ``reference``; to be better than
        that is little merit.
    """
    worth = np.log(np.clip(parts / reference, WORTHLESS, None))
    return np.array(POWERS) * np.minimum(worth, SURPLUS_SHARE * worth)
