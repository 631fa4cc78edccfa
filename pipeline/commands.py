"""What the commands of the command line do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.config import ConfigError, RunConfig, load_config
from spinpipe.pipeline.context import RunReader, thread_count
from spinpipe.pipeline.demo import DEMO_CONFIG, write_example
from spinpipe.pipeline.drawing.recording import RecordMode
from spinpipe.pipeline.engine import open_engine
from spinpipe.pipeline.init import commented_config
from spinpipe.pipeline.plan import Step, make_plan
from spinpipe.pipeline.recorder import recorder
from spinpipe.pipeline.results.write import write_results
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.runner import Runner, StageReport, locked, report_document
from spinpipe.pipeline.tables import detection_table, plan_table, stage_tables
from spinpipe.stages.stage import StageError

if TYPE_CHECKING:
    from spinpipe.pipeline.drawing.threshold import Truth


def run_command(
    path: Path,
    output: Path | None,
    overrides: list[str],
    start: str | None,
    until: str | None,
    rerun: RecordMode,
) -> None:
    """``spinpipe run``."""
    config = load_config(path, overrides)
    execute(config, run_folder(config, output), start, until, rerun)


def execute(
    config: RunConfig,
    folder: RunFolder,
    start: str | None,
    until: str | None,
    rerun: RecordMode,
    *,
    quiet: bool = False,
) -> None:
    """Run a config in a folder and, unless ``quiet``, print what was found."""
    console = Console(quiet=quiet)
    steps = make_plan(config, folder, start=start, until=until)
    with locked(folder):
        text = config.to_toml()
        write_atomically(folder.config, lambda file: file.write_text(text, encoding="utf-8"))
        done: list[str] = []
        read = RunReader(folder, done)
        stages = [step.stage.name for step in steps if step.action != "skip"]
        unchanged = all(step.action == "reuse" for step in steps)
        with (
            open_engine(config.execution, thread_count(config.execution.threads)) as engine,
            recorder(
                config.run.name,
                rerun,
                folder.recording,
                config.record.preview_points,
                keep=unchanged,
            ) as draw,
        ):

            def finished(stage: str) -> None:
                done.append(stage)
                draw(stage, read)

            reports = Runner(config, folder, engine, console).run(steps, finished)
        report = _write_report(config, folder, reports)
        if stages[-1:] == ["verify"]:
            detections = write_results(config, read, folder, report, keep=unchanged)
            console.print(detection_table(detections))
            console.print(f"results in {folder.path}/", highlight=False, soft_wrap=True)
        else:
            console.print(f"stopped after {stages[-1]}; results in {folder.path}/", highlight=False)


def _write_report(
    config: RunConfig, folder: RunFolder, reports: list[StageReport]
) -> dict[str, Any]:
    report = report_document(config, reports)
    text = json.dumps(report, indent=1) + "\n"
    write_atomically(folder.report, lambda file: file.write_text(text, encoding="utf-8"))
    return report


def run_folder(config: RunConfig, output: Path | None) -> RunFolder:
    """Name the folder of a run: as given, or recordings/<name> under the current one."""
    return RunFolder(output or Path("recordings") / config.run.name)


def plan_command(
    path: Path, output: Path | None, overrides: list[str], start: str | None, until: str | None
) -> None:
    """``spinpipe plan``."""
    config = load_config(path, overrides)
    folder = run_folder(config, output)
    steps: list[Step] = make_plan(config, folder, start=start, until=until)
    console = Console()
    console.print(plan_table(steps))
    console.print(f"in {folder.path}/", highlight=False, soft_wrap=True)


def demo_command(output: Path | None, noise_m: float, start: str | None, rerun: RecordMode) -> None:
    """``spinpipe demo``."""
    folder = RunFolder(output or Path("recordings/demo"))
    write_example(folder.path, noise_m)
    path = folder.path / "config.toml"
    write_atomically(path, lambda file: file.write_text(DEMO_CONFIG, encoding="utf-8"))
    execute(load_config(path), folder, start, None, rerun)


def init_command(path: Path, scene: str, model: str) -> None:
    """``spinpipe init``."""
    console = Console()
    if path.exists():
        raise ConfigError(f"{path}: exists already; name another file or remove it")
    if bool(scene) != bool(model):
        raise ConfigError("init: give both --scene and --model, or neither for a small example")
    if not scene:
        write_example(path.parent / "example")
        scene, model = "example/scene.ply", "example/model_1.ply"
        console.print(f"wrote {path.parent / 'example'}/: the artificial scene", highlight=False)
    text = commented_config(path.name, scene, model)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"))
    console.print(f"wrote {path}; now: spinpipe run {path}", highlight=False, soft_wrap=True)


def stages_command() -> None:
    """``spinpipe stages``."""
    console = Console()
    for table in stage_tables():
        console.print(table)


def record_command(path: Path, rerun: RecordMode, labels: Path | None = None) -> None:
    """``spinpipe record``."""
    folder = RunFolder(path)
    if not folder.config.exists():
        raise ConfigError(f"{path}: no run here: {folder.config.name} is missing")
    config = load_config(folder.config)
    read = RunReader(folder)
    stages = [name for name in config.stages if folder.mcap(name).exists()]
    if not stages:
        raise StageError(f"{path}: no stage is complete yet; run the config first")
    with (
        locked(folder),
        recorder(
            config.run.name,
            rerun,
            folder.recording,
            config.record.preview_points,
            truth=_truth(folder, labels),
        ) as draw,
    ):
        for stage in stages:
            draw(stage, read)
    if rerun == "save":
        Console().print(f"wrote {folder.recording}", highlight=False, soft_wrap=True)


def _truth(folder: RunFolder, labels: Path | None) -> Truth | None:
    """What labels say about a run's detections."""
    if labels is None:
        return None
    from spinpipe.pipeline.drawing.threshold import Truth
    from spinpipe.pipeline.evaluation.evaluate import evaluate_run

    evaluation = evaluate_run(folder, labels)
    score, detections = evaluation.accepted, evaluation.detections
    found = {detections[match.detection].id: True for match in score.matches}
    found |= {detections[i].id: False for i in score.false}
    missed = [evaluation.truths[i].position for i in score.missed]
    return Truth(found, np.array(missed, np.float64).reshape(-1, 3))
