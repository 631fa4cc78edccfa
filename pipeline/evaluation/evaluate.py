"""``spinpipe eval``: a run's detections against labels."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Literal

from rich.console import Console

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.evaluation.evaluation import (
    Rule,
    choose_rule,
    precision_recall,
    score_detections,
)
from spinpipe.pipeline.evaluation.losses import find_intruders, find_losses
from spinpipe.pipeline.evaluation.picture import write_picture
from spinpipe.pipeline.evaluation.report import (
    Evaluation,
    evaluation_document,
    evaluation_tables,
)
from spinpipe.pipeline.evaluation.truth import read_truth
from spinpipe.pipeline.outputs import locked, require_new, write_new
from spinpipe.pipeline.results.complete import open_complete
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.schemas import DETECTIONS, MODELS, SCENE, UPRIGHT
from spinpipe.stages.stage import StageError


def evaluate_run(
    folder: RunFolder,
    truth: Path,
    *,
    radius_m: float = 1.5,
    rule: Rule | None = None,
    coordinates: Literal["scene", "world"] = "scene",
) -> Evaluation:
    """Evaluate a complete run.

    Parameters
    ----------
    folder : of the run.
    truth : CSV file, see ``read_truth``.
    radius_m : farthest match.
    rule : whether models must agree; by default only if the truth names one of the run's.
    coordinates : frame of the truth.

    Raises
    ------
    StageError
        If the run is not complete, or the truth is unusable.
    """
    _, config = open_complete(folder.path)
    read = RunReader(folder)
    detections = list(read(DETECTIONS))
    models = [model.name for model in read(MODELS)]
    labelled = read_truth(truth, read(SCENE)[0], read(UPRIGHT)[0], coordinates)
    if not labelled:
        raise StageError(f"{truth}: holds no labelled object; write one line each")
    rule = rule or choose_rule(labelled, models)
    sought = [t for t in labelled if rule == "any" or not t.model or t.model in models]
    accepted = [i for i, d in enumerate(detections) if d.fate == "accepted"]
    undecided = [i for i, d in enumerate(detections) if d.fate == "ambiguous"]
    score = score_detections(sought, detections, accepted, radius_m, rule)
    return Evaluation(
        run=config.run.name,
        rule=rule,
        radius_m=radius_m,
        truths=sought,
        left_out=[t for t in labelled if t not in sought],
        detections=detections,
        accepted=score,
        with_ambiguous=score_detections(
            sought, detections, sorted(accepted + undecided), radius_m, rule
        ),
        curve=precision_recall(sought, detections, radius_m, rule),
        losses=find_losses(score, sought, detections, read, radius_m, rule),
        intruders=find_intruders(score, sought, detections, radius_m),
    )


def eval_command(
    path: Path,
    truth: Path,
    radius_m: float,
    rule: Rule | None,
    coordinates: Literal["scene", "world"],
    json_path: Path | None,
    picture: Path | None,
    force: bool,
) -> None:
    """``spinpipe eval``."""
    folder = RunFolder(path)
    for named in (json_path, picture):
        if named is not None:
            require_new(named, force=force)
    evaluation = evaluate_run(folder, truth, radius_m=radius_m, rule=rule, coordinates=coordinates)
    console = Console()
    console.print(evaluation_tables(evaluation), highlight=False)
    written = json_path or folder.path / "eval.json"
    if json_path is None:
        with locked(folder.path, force=force) as outputs:
            outputs.claim(written)
            outputs.write(written, "", partial(write_evaluation, evaluation))
    else:
        write_new(json_path, partial(write_evaluation, evaluation), force=force)
    console.print(f"wrote {written}", highlight=False, soft_wrap=True)
    if picture is not None:
        write_picture(evaluation, RunReader(folder), picture)
        console.print(f"wrote {picture}", highlight=False, soft_wrap=True)


def write_evaluation(evaluation: Evaluation, path: Path) -> None:
    """Write eval.json."""
    text = json.dumps(evaluation_document(evaluation), indent=1, allow_nan=False) + "\n"
    path.write_text(text, encoding="utf-8")
