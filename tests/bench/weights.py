"""How much the parts of a score are worth, measured on finished runs of labelled scenes.

    uv run python tests/bench/weights.py RUN=TRUTH.csv[:RADIUS_M] ...

Prints a logistic regression of right against wrong candidates over the parts, with each scene left
out in turn; how well the scores of the runs are calibrated; and what changes when a weight is
varied by a fifth.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from spinpipe.pipeline import api
from spinpipe.schemas.arrays import F64
from spinpipe.schemas.records import Detection
from spinpipe.stages.verify.judge.scoring import ODDS, PARTS, POWERS, SURPLUS_SHARE, WORTHLESS

RADIUS_M = 1.5
NEAR = 0.6
"""Share of the radius within which a candidate is surely right; up to the radius it is neither."""
RIDGE = 0.02
EDGES = np.array([0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 1])


@dataclass(frozen=True)
class Case:
    """Distinct candidates of a run: logarithms of their parts, and whether they are right."""

    name: str
    worth: F64
    right: F64
    weight: F64
    """Equal in sum for right and wrong ones."""


def read_case(argument: str) -> Case:
    """A run and its labels; candidates near an ignored label or beside one are left out."""
    run, _, truth = argument.partition("=")
    path, _, radius = truth.partition(":")
    radius_m = float(radius or RADIUS_M)
    rows = list(csv.DictReader(Path(path).read_text().splitlines()))
    places = np.array([[float(row["x"]), float(row["y"])] for row in rows])
    ignored = np.array([(row.get("ignore") or "0").strip() == "1" for row in rows])
    found = [d for d in api.open(run).detections if d.fate != "duplicate" and d.parts]
    xy = np.array([d.position_scene[:2] for d in found])
    apart = np.linalg.norm(xy[:, None] - places, axis=2)
    nearest, label = apart.min(axis=1), apart.argmin(axis=1)
    right = (nearest < NEAR * radius_m) & ~ignored[label]
    for k in set(label[right].tolist()):  # one candidate a label: the best
        rows_of = np.flatnonzero(right & (label == k))
        right[rows_of] = rows_of == max(rows_of, key=lambda row: found[row].log_odds)
    use = right | (nearest > radius_m + 1.0)
    right = right[use].astype(float)
    share = np.where(right == 1, 1 / max(right.sum(), 1), 1 / max((1 - right).sum(), 1))
    worth = np.array([_worth(d) for d in found])[use]
    return Case(Path(run).name, worth, right, 50 * share)


def _worth(detection: Detection) -> F64:
    parts = {part.name: part.value / part.reference for part in detection.parts}
    log = np.log(np.clip([parts[name] for name in PARTS], WORTHLESS, None))
    return np.minimum(log, SURPLUS_SHARE * log)


def fitted(cases: list[Case]) -> F64:
    """(1 + len(PARTS),) constant and weights of at least 0."""
    x = np.concatenate([np.c_[np.ones(len(case.right)), case.worth] for case in cases])
    right = np.concatenate([case.right for case in cases])
    weight = np.concatenate([case.weight for case in cases])

    def loss(w: F64) -> tuple[float, F64]:
        z = x @ w
        gradient = x.T @ (weight * (expit(z) - right))
        ridge = RIDGE * np.r_[0.0, w[1:]]
        value = (weight * (np.logaddexp(0.0, z) - right * z)).sum() + ridge @ w
        return float(value), gradient + 2 * ridge

    bounds = [(None, None)] + [(0, None)] * len(PARTS)
    start = np.r_[2.0, np.ones(len(PARTS))]
    return minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B").x


def report(case: Case, w: F64) -> str:
    """Average precision of the ranking, and what a score of a half accepts."""
    z = w[0] + case.worth @ w[1:]
    hit = case.right[np.argsort(-z, kind="stable")]
    precision = np.cumsum(hit) / np.arange(1, len(hit) + 1)
    average = (precision * hit).sum() / max(hit.sum(), 1)
    found, wrong = int(case.right[z > 0].sum()), int((1 - case.right)[z > 0].sum())
    return f"{case.name:20} AP {average:.3f}  {found} of {int(hit.sum())}, {wrong} wrong"


def reliability(cases: list[Case], w: F64) -> None:
    """Print how many of the candidates of each score are right."""
    score = np.concatenate([expit(w[0] + case.worth @ w[1:]) for case in cases])
    right = np.concatenate([case.right for case in cases])
    for low, high in pairwise(EDGES):
        inside = (score >= low) & ((score < high) | (high == 1))
        share = right[inside].mean() if inside.any() else np.nan
        print(f"  score {low:.2f} to {high:.2f}: {inside.sum():5} candidates, {share:5.0%} right")


def main(arguments: list[str]) -> None:
    """Read the runs and print everything."""
    cases = [read_case(argument) for argument in arguments]
    if not cases:
        sys.exit(__doc__)
    print("constant and weights of", ", ".join(PARTS))
    for case in cases:
        others = [c for c in cases if c.name.split("-")[0] != case.name.split("-")[0]]
        if others:
            w = fitted(others)
            print("without", report(case, w), np.round(w, 1))
    print("all together", np.round(fitted(cases), 1))
    now = np.r_[ODDS, POWERS]
    print("as it is", now)
    for case in cases:
        print(" ", report(case, now))
    reliability(cases, now)
    print("a weight varied by a fifth: accepted right and wrong ones, of all cases")
    for k, name in enumerate(("constant", *PARTS)):
        counts: list[str] = []
        for factor in (0.8, 1.0, 1.2):
            w = now * np.where(np.arange(len(now)) == k, factor, 1.0)
            up = [(c.right, w[0] + c.worth @ w[1:] > 0) for c in cases]
            found = sum(int(right[z].sum()) for right, z in up)
            wrong = sum(int((1 - right)[z].sum()) for right, z in up)
            counts.append(f"{factor:.1f}: {found} and {wrong}")
        print(f"  {name:10}", ",  ".join(counts))


if __name__ == "__main__":
    main(sys.argv[1:])
