"""Tables of the recognition benchmark."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from recognition_judge import Trial

COLUMNS = (
    "object", "scene", "across", "noise", "view", "n", "found", "false", "amb.", "recall", "prec.",
    "pos 50%", "pos 95%", "of size", "turn 50%", "turn 95%", "flips", "s", "lost by",
)  # fmt: skip
BINS = np.array([0.0, 0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])


def print_table(trials: Sequence[Trial]) -> None:
    """Print a row for each trial, then totals by condition, by object and over all."""
    rows = [_row(t.sought, t.condition, [t]) for t in trials]
    rows += _totals(trials, lambda t: t.condition)
    rows += _totals(trials, lambda t: t.sought)
    rows.append(_row("total", "", trials))
    _print_aligned([list(COLUMNS), *rows])


def _totals(trials: Sequence[Trial], key: Callable[[Trial], str]) -> list[list[str]]:
    names = list(dict.fromkeys(key(t) for t in trials))
    if not 1 < len(names) < len(trials):
        return []
    return [_row("all", name, [t for t in trials if key(t) == name]) for name in names]


def _row(what: str, scene: str, trials: Sequence[Trial]) -> list[str]:
    one = trials[0] if len(trials) == 1 else None
    count, found = sum(t.instances for t in trials), sum(t.found for t in trials)
    false = sum(t.false for t in trials)
    position = [p for t in trials for p in t.position_m]
    relative = [p / t.size_m for t in trials for p in t.position_m]
    heading = [h for t in trials for h in t.heading_deg]
    lost = sum((Counter(t.lost_by) for t in trials), Counter[str]())
    return [
        what,
        scene,
        f"{one.spacings_across:.0f}" if one else "",
        f"{one.noise:.0%}" if one else "",
        one.view if one else "",
        *(str(v) for v in (count, found, false, sum(t.ambiguous for t in trials))),
        f"{found / count:.2f}" if count else "",
        f"{found / (found + false):.2f}" if found + false else "",
        *_percentiles(position, ".3f"),
        _percentiles(relative, ".1%")[0],
        *_percentiles(heading, ".1f"),
        str(sum(t.flips for t in trials)),
        f"{sum(t.seconds for t in trials):.0f}",
        one.error if one and one.error else ", ".join(f"{k} {n}" for k, n in lost.most_common()),
    ]


def _percentiles(values: Sequence[float], form: str) -> list[str]:
    return [f"{v:{form}}" for v in np.percentile(values, [50, 95])] if values else ["", ""]


def _print_aligned(rows: Sequence[Sequence[str]]) -> None:
    widths = [max(len(row[k]) for row in rows) for k in range(len(COLUMNS) - 1)]
    for row in rows:
        words = [
            cell.ljust(w) if k in (0, 1, 4) else cell.rjust(w)
            for k, (cell, w) in enumerate(zip(row, widths, strict=False))
        ]
        print("  ".join([*words, row[-1]]).rstrip())


def print_reliability(trials: Sequence[Trial]) -> None:
    """Print how many candidates of each bin of the score are right."""
    judged = [j for t in trials for j in t.judged]
    scores, right = np.array([s for s, _ in judged]), np.array([r for _, r in judged], bool)
    print("\nscore        places  right  share  mean score")
    for low, high in pairwise(BINS.tolist()):
        rows = (scores >= low) & ((scores < high) | ((high == 1.0) & (scores <= high)))
        share = f"{right[rows].mean():.2f}" if rows.any() else ""
        mean = f"{scores[rows].mean():.2f}" if rows.any() else ""
        print(
            f"{low:.2f}..{high:.2f}  {rows.sum():6d} {right[rows].sum():6d}  {share:>5}  {mean:>5}"
        )
    if len(scores):
        print(f"Brier score {np.mean((scores - right) ** 2):.4f}")


def print_details(trials: Sequence[Trial]) -> None:
    """Print every miss and every false detection with the parts of its score."""
    for t in trials:
        for m in t.misses:
            print(
                f"missed {t.sought}/{t.condition} {m['kind']}: {m['stage']}: {m['detail']}", end=" "
            )
            print(m.get("score", ""), m.get("observed", ""), m.get("parts", ""))
        for i in t.intruders:
            print(f"false {t.sought}/{t.condition} on {i['on']} ({i['kind']}):", end=" ")
            print(i["score"], i["observed"], i["parts"])
