"""An evaluation as a table for the terminal and as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from spinpipe.pipeline.evaluation.evaluation import Curve, Rule, Score, percentiles
from spinpipe.pipeline.evaluation.losses import Intruder, Loss, describe
from spinpipe.pipeline.evaluation.truth import TruthObject
from spinpipe.schemas.records import Detection

MAX_ROWS = 20
FATES = ("accepted", "ambiguous")


@dataclass(frozen=True)
class Evaluation:
    """Everything that was found out about one run against one truth."""

    run: str
    rule: Rule
    radius_m: float
    truths: Sequence[TruthObject]
    left_out: Sequence[TruthObject]
    """Of models that the run did not look for."""
    detections: Sequence[Detection]
    accepted: Score
    with_ambiguous: Score
    curve: Curve
    losses: Sequence[Loss]
    intruders: Sequence[Intruder]


def evaluation_tables(evaluation: Evaluation) -> Group:
    """Counts, errors, and every miss and every false detection."""
    return Group(
        Text(_rule_text(evaluation)),
        _counts(evaluation),
        *_errors(evaluation.accepted),
        *_missed(evaluation),
        *_false(evaluation),
    )


def _rule_text(e: Evaluation) -> str:
    models = "of the same model" if e.rule == "name" else "of any model"
    text = f"detections {models} match within {e.radius_m:g} m"
    ignored = sum(t.ignore for t in e.truths)
    if ignored:
        text += f"; {ignored} labels count neither way"
    if e.left_out:
        names = ", ".join(sorted({t.model for t in e.left_out}))
        text += f"; {len(e.left_out)} labels of {names} left out: not looked for"
    return text


def _counts(e: Evaluation) -> Table:
    table = _table("", "labels", "found", "missed", "false", "recall", "precision", "F1", "AP")
    for name, score, area in (
        ("accepted", e.accepted, f"{e.curve.average_precision:.3f}"),
        ("with ambiguous", e.with_ambiguous, ""),
    ):
        found, missed = len(score.matches), len(score.missed)
        counts = (str(n) for n in (found + missed, found, missed, len(score.false)))
        shares = (_number(v, ".3f") for v in (score.recall, score.precision, score.f1))
        table.add_row(name, *counts, *shares, area)
    return table


def _errors(score: Score) -> Iterator[Table | Text]:
    if not score.matches:
        return
    table = _table("error", "median", "95 %", "largest")
    for name, values, unit in (
        ("position", [m.distance_m for m in score.matches], ".2f"),
        ("height", [m.height_error_m for m in score.matches], ".2f"),
        ("axis", [m.axis_error_deg for m in score.matches], ".1f"),
        ("heading", [m.heading_error_deg for m in score.matches], ".1f"),
    ):
        cells = [_number(v, unit) for v in percentiles(values, 50, 95, 100)]
        if any(v is not None for v in values):
            suffix = " m" if unit == ".2f" else "°"
            table.add_row(name, *(cell + suffix for cell in cells))
    yield table
    known = [m for m in score.matches if m.heading_error_deg is not None]
    if known:
        yield Text(f"turned by 180°: {sum(m.flipped for m in known)} of {len(known)}")


def _missed(e: Evaluation) -> Iterator[Table | Text]:
    if not e.losses:
        return
    stages = Counter(loss.stage for loss in e.losses)
    yield Text("\nmissed: " + ", ".join(f"{n} by {stage}" for stage, n in stages.most_common()))
    table = _table("line", "x", "y", "lost by", "id", "score", "why", words=("lost by", "why"))
    for loss in e.losses[:MAX_ROWS]:
        truth = e.truths[loss.truth]
        table.add_row(
            str(truth.row),
            *(f"{v:.1f}" for v in truth.given),
            loss.stage,
            "" if loss.candidate is None else str(loss.candidate),
            _number(loss.score, ".2f", ""),
            loss.detail,
        )
    yield table
    yield from _more(len(e.losses))


def _false(e: Evaluation) -> Iterator[Table | Text]:
    if not e.intruders:
        return
    kinds = Counter(intruder.kind for intruder in e.intruders)
    yield Text("\nfalse: " + ", ".join(f"{n} {kind}" for kind, n in kinds.most_common()))
    table = _table("id", "x", "y", "score", "what", "where", words=("what", "where"))
    for intruder in e.intruders[:MAX_ROWS]:
        d = e.detections[intruder.detection]
        table.add_row(
            str(d.id),
            *(f"{v:.1f}" for v in d.position_scene[:2]),
            f"{d.score:.2f}",
            intruder.kind,
            intruder.detail,
        )
    yield table
    yield from _more(len(e.intruders))


def _more(rows: int) -> Iterator[Text]:
    if rows > MAX_ROWS:
        yield Text(f"and {rows - MAX_ROWS} more in eval.json")


def _table(*columns: str, words: tuple[str, ...] = ()) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for i, name in enumerate(columns):
        is_text = name in words or (i == 0 and not words)
        table.add_column(name, justify="left" if is_text else "right", no_wrap=not is_text)
    return table


def _number(value: float | None, form: str, none: str = "-") -> str:
    return none if value is None else format(value, form)


def evaluation_document(e: Evaluation) -> dict[str, Any]:
    """Content of eval.json; x and y of labels are as their file has them."""
    return {
        "schema": 1,
        "run": e.run,
        "match": {"radius_m": e.radius_m, "model": e.rule},
        "labels": {
            "counted": sum(not t.ignore for t in e.truths),
            "ignored": sum(t.ignore for t in e.truths),
            "left_out": len(e.left_out),
        },
        "accepted": _score_entry(e, e.accepted),
        "with_ambiguous": _score_entry(e, e.with_ambiguous),
        "average_precision": e.curve.average_precision,
        "precision_recall": {
            "score": e.curve.score.tolist(),
            "recall": e.curve.recall.tolist(),
            "precision": e.curve.precision.tolist(),
        },
        "missed": [_loss_entry(e, loss) for loss in e.losses],
        "false": [_intruder_entry(e, intruder) for intruder in e.intruders],
    }


def _score_entry(e: Evaluation, score: Score) -> dict[str, Any]:
    errors = {
        "position_m": [m.distance_m for m in score.matches],
        "height_m": [m.height_error_m for m in score.matches],
        "axis_deg": [m.axis_error_deg for m in score.matches],
        "heading_deg": [m.heading_error_deg for m in score.matches],
    }
    names = ("median", "p95", "largest")
    known = [m for m in score.matches if m.heading_error_deg is not None]
    return {
        "found": len(score.matches),
        "missed": len(score.missed),
        "false": len(score.false),
        "on_ignored": len(score.neither),
        "recall": score.recall,
        "precision": score.precision,
        "f1": score.f1,
        "errors": {
            name: dict(zip(names, percentiles(values, 50, 95, 100), strict=True))
            for name, values in errors.items()
        },
        "flipped": sum(m.flipped for m in known) if known else None,
        "matches": [
            {
                "line": e.truths[m.truth].row,
                "detection": e.detections[m.detection].id,
                "position_error_m": m.distance_m,
                "height_error_m": m.height_error_m,
                "axis_error_deg": m.axis_error_deg,
                "heading_error_deg": m.heading_error_deg,
            }
            for m in score.matches
        ],
    }


def _loss_entry(e: Evaluation, loss: Loss) -> dict[str, Any]:
    truth = e.truths[loss.truth]
    return {
        "line": truth.row,
        "what": describe(truth),
        "x": truth.given[0],
        "y": truth.given[1],
        "stage": loss.stage,
        "why": loss.detail,
        "detection": loss.candidate,
        "score": loss.score,
    }


def _intruder_entry(e: Evaluation, intruder: Intruder) -> dict[str, Any]:
    d = e.detections[intruder.detection]
    return {
        "detection": d.id,
        "model": d.model,
        "position_scene": list(d.position_scene),
        "kind": intruder.kind,
        "where": intruder.detail,
        "admitted_by": d.reason,
        "score": d.score,
        "parts": {part.name: part.value for part in d.parts},
    }
