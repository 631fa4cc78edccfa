"""What the commands of the command line do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from rich.console import Console

from spinpipe.pipeline.advice import advice
from spinpipe.pipeline.atomic import write_atomically
from spinpipe.pipeline.config import ConfigError, RunConfig, config_of, load_config
from spinpipe.pipeline.context import RunReader, require_origin, thread_count
from spinpipe.pipeline.demo import DEMO_CONFIG, EXAMPLE_FILES, write_example
from spinpipe.pipeline.drawing.recording import RecordMode
from spinpipe.pipeline.engine import open_engine
from spinpipe.pipeline.init import commented_config, filled_in, preset_config
from spinpipe.pipeline.inspect import Facts, inspect_file, is_searched, look_again
from spinpipe.pipeline.memory import fitting_threads
from spinpipe.pipeline.outputs import Outputs, locked, require_new, write_new
from spinpipe.pipeline.plan import Step, make_plan
from spinpipe.pipeline.recorder import recorder, recording_key
from spinpipe.pipeline.results.complete import open_run_folder
from spinpipe.pipeline.results.write import results_key, write_results
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.run_state import keys_in, require_inputs_apart, write_config
from spinpipe.pipeline.runner import Runner, report_document
from spinpipe.pipeline.scale_search import remembered, resolve_scale, with_scale
from spinpipe.pipeline.tables import detection_table, facts_table, plan_table, stage_tables
from spinpipe.stages import STAGES
from spinpipe.stages.ingest.vehicles import VEHICLES
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
    force: bool,
) -> None:
    """``spinpipe run``."""
    config = load_config(path, overrides)
    execute(config, run_folder(config, output), start, until, rerun, force=force)


def execute(
    config: RunConfig,
    folder: RunFolder,
    start: str | None,
    until: str | None,
    rerun: RecordMode,
    *,
    quiet: bool = False,
    force: bool = False,
) -> None:
    """Run a config in a folder and, unless ``quiet``, print what was found.

    ``force`` lets it replace files in the folder that are not from spinpipe, but never an input.
    """
    console = Console(quiet=quiet)
    require_inputs_apart(config, folder)
    threads = fitting_threads(config, recording=rerun != "off")
    if threads < thread_count(config.execution.threads):
        console.print(f"{threads} threads: no more fit into execution.memory_gb", highlight=False)
    with locked(folder.path, force=force) as outputs:
        outputs.claim(*folder.files)
        config, searched = resolve_scale(config, folder, outputs, console, threads)
        steps = make_plan(config, folder, start=start, until=until)
        keys = keys_in(folder, steps)
        if any(step.action == "run" for step in steps):  # they would no longer follow from it
            outputs.discard(*folder.results, folder.recording)
        if not outputs.current(folder.recording, recording_key(config, keys)):
            outputs.discard(folder.recording)
        key = results_key(config, keys)
        outputs.discard(*(path for path in folder.results if not outputs.current(path, key)))
        done: list[str] = []
        read = RunReader(folder, done)
        stages = [step.stage.name for step in steps if step.action != "skip"]
        with (
            open_engine(config.execution, threads) as engine,
            recorder(config, folder, rerun, outputs, keys) as draw,
        ):

            def finished(stage: str) -> None:
                done.append(stage)
                write_config(config, folder, steps, done, outputs)
                draw(stage, read)

            reports = Runner(config, folder, engine, console).run(steps, finished)
            reports[0].notes = searched + reports[0].notes
        report = report_document(config, reports)
        text = json.dumps(report, indent=1) + "\n"
        outputs.write(folder.report, "", lambda file: file.write_text(text, encoding="utf-8"))
        if stages[-1:] == ["verify"]:
            detections = write_results(config, read, folder, report, outputs, key)
            console.print(detection_table(detections))
            for line in advice(read, detections):
                console.print(f"- {line}", highlight=False, markup=False, soft_wrap=True)
            console.print(f"results in {folder.path}/", highlight=False, soft_wrap=True)
        else:
            console.print(f"stopped after {stages[-1]}; results in {folder.path}/", highlight=False)


def run_folder(config: RunConfig, output: Path | None) -> RunFolder:
    """Name the folder of a run: as given, or recordings/<name> under the current one."""
    return RunFolder(output or Path("recordings") / config.run.name)


def plan_command(
    path: Path, output: Path | None, overrides: list[str], start: str | None, until: str | None
) -> None:
    """``spinpipe plan``."""
    config = load_config(path, overrides)
    folder = run_folder(config, output)
    console = Console()
    found = remembered(config, folder, Outputs(folder.path)) if is_searched(config) else None
    if found:
        config = with_scale(config, found)
    if is_searched(config):
        console.print("the scale is searched first, then every stage runs", highlight=False)
    else:
        steps: list[Step] = make_plan(config, folder, start=start, until=until)
        console.print(plan_table(steps))
    console.print(f"in {folder.path}/", highlight=False, soft_wrap=True)
    for note in look_again(config, folder, Console(stderr=True)):
        console.print(f"- {note}", highlight=False, markup=False, soft_wrap=True)


def inspect_command(files: list[Path], role: Literal["", "scene", "model"], as_json: bool) -> None:
    """``spinpipe inspect``."""
    console = Console()
    every: list[Facts] = []
    for path in files:
        try:
            facts = inspect_file(path, role, Console(stderr=True))
        except StageError as error:
            facts = {"path": str(path), "refused": str(error)}
        every.append(facts)
        if not as_json and "role" in facts:
            console.print(facts_table(facts))
    if as_json:
        console.out(json.dumps({"schema": 1, "files": every}, indent=1), highlight=False)
    refused = [facts["refused"] for facts in every if facts["refused"]]
    if refused:
        more = f" ({len(refused) - 1} more would be refused)" if len(refused) > 1 else ""
        raise StageError(refused[0] + more)


def demo_command(
    output: Path | None, noise_m: float, start: str | None, rerun: RecordMode, force: bool
) -> None:
    """``spinpipe demo``."""
    folder = RunFolder(output or Path("recordings/demo"))
    path = folder.path / "config.toml"
    with locked(folder.path, force=force) as outputs:
        files = (*(folder.path / name for name in EXAMPLE_FILES), path)
        outputs.claim(*files)
        for file in files:
            if outputs.edited(file) and not force:
                raise StageError(f"{file}: was edited; demo would replace it: use --force")
        write_example(folder.path, noise_m)
        write_atomically(path, lambda file: file.write_text(DEMO_CONFIG, encoding="utf-8"))
        for file in files:
            outputs.written(file, "")
    execute(load_config(path), folder, start, None, rerun, force=force)


def init_command(
    path: Path,
    scene: str,
    models: list[str],
    shapes: list[str],
    preset: str,
    overrides: list[str],
    force: bool,
) -> None:
    """``spinpipe init``."""
    console = Console()
    require_new(path, force=force)
    notes: list[str] = []
    if preset:
        if models or shapes:
            raise ConfigError("init: a --preset says what to look for; leave --model and --shape")
        text, notes = preset_config(preset, path, scene, overrides)
    elif scene:
        if not models and not shapes:
            raise ConfigError(
                "init: say what to look for: --model FILE, or --shape, one of "
                + ", ".join(VEHICLES)
            )
        document, notes = filled_in(path, scene, models, shapes, overrides)
        text = commented_config(path.name, document)
    elif models or shapes:
        raise ConfigError("init: give a --scene too, or nothing for a small example")
    else:
        example = path.parent / "example"
        for name in EXAMPLE_FILES:
            require_new(example / name, force=force)
        write_example(example)
        console.print(f"wrote {example}/: the artificial scene", highlight=False)
        model = {"name": "model_1", "path": "example/model_1.ply"}
        document = {"ingest": {"scene": "example/scene.ply"}, "model": [model]}
        config_of(document, path, overrides)
        text = commented_config(path.name, document)
    for note in notes:
        console.print(note, highlight=False, markup=False, soft_wrap=True)
    write_new(path, lambda file: file.write_text(text, encoding="utf-8"), force=force)
    console.print(f"wrote {path}; now: spinpipe run {path}", highlight=False, soft_wrap=True)


def stages_command() -> None:
    """``spinpipe stages``."""
    console = Console()
    for table in stage_tables():
        console.print(table)


def record_command(path: Path, rerun: RecordMode, labels: Path | None, force: bool) -> None:
    """``spinpipe record``."""
    folder, config = open_run_folder(path)
    for stage in STAGES:  # a damaged file is no missing one
        if folder.mcap(stage.name).exists():
            require_origin(folder, stage.name)
    keys = keys_in(folder)
    if not keys:
        raise StageError(f"{path}: no stage is complete yet; run the config first")
    truth = _truth(folder, labels)
    with locked(folder.path, force=force) as outputs:
        outputs.claim(folder.recording)
        outputs.discard(folder.recording)
        with recorder(config, folder, rerun, outputs, keys, truth) as draw:
            read = RunReader(folder)
            for stage in keys:
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
