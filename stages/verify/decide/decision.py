"""The decision: competition of headings and models, and the reason for every fate.

Which candidates keep their place is decided before, see ``neighbours`` and ``judge.resolve``.
"""

from __future__ import annotations

import math

import numpy as np

from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import Part
from spinpipe.stages.verify.decide.continuation import (
    explained_sides,
    first_continuing,
    fits_farther_on,
)
from spinpipe.stages.verify.decide.group import judged_by_group
from spinpipe.stages.verify.decide.neighbours import explain_neighbours, standing
from spinpipe.stages.verify.decide.verdict import Cause, Fate, Rules, Verdict
from spinpipe.stages.verify.evidence.gather import EVIDENCE
from spinpipe.stages.verify.evidence.outline import SIDES
from spinpipe.stages.verify.judge.hypothesis_table import Hypotheses
from spinpipe.stages.verify.judge.standards import Standards
from spinpipe.stages.verify.model.known_object import KnownObject

AS_GOOD = 3.0
"""Log odds by which a fit farther on may be worse, one in twenty: chosen."""
NO_ODDS = -99.0
"""Log odds where there is nothing to judge."""


def decide(standards: Standards, table: Hypotheses, places: F64, rules: Rules) -> list[Verdict]:
    """The verdict on every candidate, given all hypotheses."""
    table = explain_neighbours(standards, table, rules.min_score)
    near = standing(standards, table, rules.min_score)
    table = judged_by_group(standards, table, near.best.rows(near.displaced_by < 0))
    near = standing(standards, table, rules.min_score)  # scores have changed
    best = near.best
    rows_of = table.rows_of_candidates(len(places))
    sizes = standards.sizes(best)
    farther = np.zeros((len(sizes), len(SIDES)), np.bool_)
    for k, rows in enumerate([rows_of[c] for c in best.candidate]):
        as_good = (table.model[rows] == best.model[k]) & (table.odds[rows] > best.odds[k] - AS_GOOD)
        farther[k] = fits_farther_on(best.upright[k], sizes[k], table.upright[rows[as_good]])
    continuing = first_continuing(
        best.measured(*(f"{side}_level" for side in SIDES)),
        explained_sides(best.upright, sizes, near.poses, near.sizes),
        farther,
    )
    position = {int(c): k for k, c in enumerate(best.candidate)}
    verdicts: list[Verdict] = []
    for candidate, rows in enumerate(rows_of):
        k = position.get(candidate)
        if k is None:
            verdicts.append(_nothing_there(candidate, places[candidate]))
        else:
            rivals = table.rows(rows)
            verdicts.append(
                _judge(standards, best, k, rivals, int(near.displaced_by[k]), continuing[k], rules)
            )
    return verdicts


def _nothing_there(candidate: int, place: F64) -> Verdict:
    pose = np.array([place[0], place[1], place[2], 0.0, 1.0, 1.0, 1.0])
    return Verdict(
        candidate=candidate,
        model=0,
        pose=pose,
        lean=np.zeros(2),
        size_m=np.zeros(3),
        parts=(),
        evidence={},
        odds=NO_ODDS,
        score=0.0,
        fate="rejected",
        cause="nothing",
        reason="no surface above the ground that any model could explain",
        duplicate_of=-1,
        heading_margin=0.0,
        runner_up=pose,
        runner_up_rms_m=math.inf,
        alternative=-1,
        alternative_margin=0.0,
    )


def _judge(
    standards: Standards,
    best: Hypotheses,
    k: int,
    rivals: Hypotheses,
    displaced_by: int,
    continuing: str,
    rules: Rules,
) -> Verdict:
    """The verdict on candidate ``best.candidate[k]``, given all hypotheses about it."""
    known = standards.objects[int(best.model[k])]
    value = float(best.score[k])
    evidence: dict[str, float] = dict(zip(EVIDENCE, best.evidence[k].tolist(), strict=True))
    margin, runner_up, runner_up_rms_m = _heading_margin(standards, best, k, rivals)
    alternative, lead = _alternative(standards, best, k, rivals)
    parts = standards.parts_of(best.parts[k], int(best.model[k]))
    fate, cause, reason = _fate(known, evidence, parts, value, rules)
    duplicate_of = -1
    if displaced_by >= 0 and best.score[displaced_by] >= rules.min_score:
        duplicate_of = int(best.candidate[displaced_by])
        fate, cause = "duplicate", "duplicate"
        reason = f"stands where candidate {duplicate_of} stands, which explains more"
    elif fate == "accepted" and continuing and known.rigid:
        fate, cause = "ambiguous", "continues"
        reason = f"what stands there goes on beyond the {continuing} of the model"
    elif fate == "accepted" and alternative >= 0 and lead < rules.min_margin and known.rigid:
        fate, cause = "ambiguous", "type"
        reason = f"{standards.objects[alternative].name} scores only {lead:.3f} less"
    if fate == "accepted" and margin < rules.min_margin:
        # an instance stands there all the same; the runner-up says how else it may be turned
        reason += f"; heading undecided, another one scores only {margin:.3f} less"
    return Verdict(
        candidate=int(best.candidate[k]),
        model=int(best.model[k]),
        pose=best.pose[k],
        lean=best.lean[k],
        size_m=standards.sizes(best.rows(np.array([k])))[0],
        parts=parts,
        evidence=evidence,
        odds=float(best.odds[k]),
        score=value,
        fate=fate,
        cause=cause,
        reason=reason,
        duplicate_of=duplicate_of,
        heading_margin=margin,
        runner_up=runner_up,
        runner_up_rms_m=runner_up_rms_m,
        alternative=alternative,
        alternative_margin=lead,
    )


def _fate(
    known: KnownObject,
    evidence: dict[str, float],
    parts: tuple[Part, ...],
    value: float,
    rules: Rules,
) -> tuple[Fate, Cause, str]:
    """Fate and reason of a hypothesis in itself, whatever its rivals are."""
    observed = evidence["supported"] + evidence["contradicted"]
    if value < rules.min_score:
        weakest = min(parts, key=lambda part: part.merit)
        return (
            "rejected",
            "score",
            (
                # rounded down: 0.498 is not "0.50 below 0.5"
                f"score {math.floor(100 * value) / 100:.2f} below {rules.min_score:g}; "
                f"{weakest.name} costs most: {weakest.value:.2f}, a right one has "
                f"{weakest.reference:.2f}"
            ),
        )
    if observed < rules.min_observed:
        return "rejected", "observed", f"only {observed:.0%} of its visible surface was observed"
    if known.visible_from == "above" and evidence["sheltered"] > rules.max_sheltered:
        return (
            "ambiguous",
            "sheltered",
            (
                f"{evidence['sheltered']:.0%} of it lies below something else, "
                "but the model is declared visible from above"
            ),
        )
    # dark paint and glass give no return, but ground is seen all around them
    missing = 1.0 - evidence["ring"]
    swallowed = evidence["drop"] * max(evidence["empty"] - missing, 0.0)
    share = (observed + swallowed) / max(1.0 - evidence["covered"], 1e-9)
    if known.visible_from == "above" and share < rules.min_reconstructed:
        return (
            "ambiguous",
            "observed",
            (
                f"only {share:.0%} of it was reconstructed, by the border or a hole of the cloud, "
                "but the model is declared visible from above"
            ),
        )
    return (
        "accepted",
        "shown",
        f"score {value:.2f}, {evidence['supported']:.0%} of its surface seen",
    )


def _heading_margin(
    standards: Standards, best: Hypotheses, k: int, rivals: Hypotheses
) -> tuple[float, F64, float]:
    """How much better the heading is than the best other one of the same model."""
    model = int(best.model[k])
    known, sampling = standards.objects[model], standards.sampling
    error_m = max(sampling.noise_m, standards.error_m[model])
    turn = np.angle(np.exp(1j * (rivals.yaw - best.yaw[k])))
    moved = rivals.base - best.base[k]
    other = (rivals.model == best.model[k]) & (np.abs(turn) > math.pi / 6)
    other &= np.hypot(moved[:, 0], moved[:, 1]) < known.field.narrow_m
    cos, sin = math.cos(best.yaw[k]), math.sin(best.yaw[k])
    shift = moved @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    for row in np.flatnonzero(other)[np.argsort(-rivals.odds[other], kind="stable")]:
        if not known.field.looks_same(float(turn[row]), shift[row], error_m, sampling.spacing_m):
            lead = float(best.score[k] - rivals.score[row])
            return lead, rivals.pose[row], float(rivals.measured("rms_m")[row])
    return float(best.score[k]), best.pose[k], math.inf


def _alternative(
    standards: Standards, best: Hypotheses, k: int, rivals: Hypotheses
) -> tuple[int, float]:
    """The next best model at that place, and by how much the best one leads."""
    moved = np.hypot(*(rivals.base[:, :2] - best.base[k, :2]).T)
    narrow_m = standards.objects[int(best.model[k])].field.narrow_m
    others = np.flatnonzero((rivals.model != best.model[k]) & (moved < narrow_m))
    if len(others) == 0:
        return -1, float(best.score[k])
    row = others[np.argmax(rivals.score[others])]
    return int(rivals.model[row]), float(best.score[k] - rivals.score[row])
