"""Runs a plan: each stage into its own MCAP file, drawn into the recording, results at the end."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from spinpipe.pipeline.atomic import commit
from spinpipe.pipeline.config import RunConfig
from spinpipe.pipeline.context import RunContext
from spinpipe.pipeline.engine import Engine
from spinpipe.pipeline.keys import input_identities
from spinpipe.pipeline.mcap_file import DamagedFileError, StageFileWriter, read_metadata, recover
from spinpipe.pipeline.memory import working_bytes
from spinpipe.pipeline.plan import Step
from spinpipe.pipeline.progress import stage_progress
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.stages import STAGES
from spinpipe.stages.stage import StageError

LIBRARIES = ("spinpipe", "numpy", "scipy", "numba", "mcap", "rerun-sdk", "pyproj", "kiss-icp")


@dataclass
class StageReport:
    """What happened to one stage."""

    stage: str
    key: str
    action: str
    reason: str
    seconds: float = 0.0
    """Of the run that computed it, also where it is reused; likewise the notes."""
    notes: list[str] = field(default_factory=list[str])


class Runner:
    """Executes the steps of a plan in one folder.

    Parameters
    ----------
    config, folder, engine : of the run.
    console : shows progress.
    tell : whether it also says what each stage does and found.
    """

    def __init__(
        self,
        config: RunConfig,
        folder: RunFolder,
        engine: Engine,
        console: Console,
        *,
        tell: bool = True,
    ) -> None:
        self._config = config
        self._folder = folder
        self._engine = engine
        self._console = console
        self._tell = tell

    def run(
        self, steps: list[Step], on_stage: Callable[[str], None] = lambda _: None
    ) -> list[StageReport]:
        """Run or reuse every step; ``on_stage`` is called when a stage's file is complete.

        Raises
        ------
        StageError
            From a stage, or if a file of an earlier stage turns out damaged or another.
        """
        reports: list[StageReport] = []
        for step in steps:
            report = StageReport(step.stage.name, step.key, step.action, step.reason)
            reports.append(report)
            if step.action == "skip":
                continue
            if self._tell:
                self._say(step)
            if step.action == "run":
                self._run_stage(step, report)
            else:
                self._require_unchanged(step)
                result = read_metadata(self._folder.mcap(step.stage.name), "result")
                report.seconds = float(result["seconds"])
                report.notes = json.loads(result.get("notes", "[]"))
            on_stage(step.stage.name)
        return reports

    def _say(self, step: Step) -> None:
        action = {"run": "[bold]run  [/]", "reuse": "[dim]reuse[/]"}[step.action]
        line = f"{action} {step.stage.name:<8} {escape(step.reason)}"
        self._console.print(line, highlight=False, soft_wrap=True)

    def _require_unchanged(self, step: Step) -> None:
        """Another process may have worked in the folder after the plan was made."""
        path = self._folder.mcap(step.stage.name)
        if not path.exists() or read_metadata(path, "stage").get("key") != step.key:
            raise StageError(f"{path}: was changed meanwhile by another run; run again")

    def _run_stage(self, step: Step, report: StageReport) -> None:
        name = step.stage.name
        partial = self._folder.partial(name)
        self._set_aside(step)
        about = {"stage": name, "key": step.key, "parts": json.dumps(step.parts)}
        about["section"] = step.config.model_dump_json()
        writer = StageFileWriter(partial, about, number=STAGES.index(step.stage) + 1)
        for topic in step.stage.outputs:
            writer.declare(topic)
        began = time.perf_counter()
        try:
            with stage_progress(self._console, name) as progress:
                context = RunContext(
                    stage=step.stage,
                    config=step.config,
                    seed=self._config.run.seed,
                    key=step.key,
                    folder=self._folder,
                    writer=writer,
                    engine=self._engine,
                    memory_bytes=working_bytes(self._config.execution.memory_gb),
                    scratch=self._folder.path,
                    progress=progress,
                )
                step.stage.run(context)
            if input_identities(step.stage, step.config) != step.inputs:
                raise StageError("an input was changed while it was read; run again")
            for topic, seconds, message in context.views.messages():
                writer.write_view(topic, seconds, message)
            report.seconds = round(time.perf_counter() - began, 3)
            report.notes = context.notes
            result = {"seconds": str(report.seconds), "notes": json.dumps(report.notes)}
            writer.close(result | library_versions())
        except StageError as error:
            writer.abandon()
            partial.unlink()
            self._folder.interrupted(name).unlink(missing_ok=True)
            raise StageError(f"{name}: {error}".replace(f"{name}: {name}: ", f"{name}: ")) from None
        except DamagedFileError as error:
            writer.abandon()
            partial.unlink()
            raise StageError(f"{name}: {error}; run again to make it anew") from None
        except BaseException:
            writer.abandon()  # what is written so far stays, for the next run to go on from
            raise
        commit(partial, self._folder.mcap(name))
        self._folder.interrupted(name).unlink(missing_ok=True)
        for note in report.notes if self._tell else ():
            self._console.print(
                f"      {'':<8} {note}", highlight=False, markup=False, soft_wrap=True
            )

    def _set_aside(self, step: Step) -> None:
        """Keep the longer of what interrupted runs left, where ``Context.recovered`` finds it."""
        name = step.stage.name
        partial, interrupted = self._folder.partial(name), self._folder.interrupted(name)

        def length(path: Path) -> int:
            return sum(1 for topic in step.stage.outputs for _ in recover(path, step.key, topic))

        if partial.exists() and length(partial) >= length(interrupted):
            partial.replace(interrupted)


@cache
def library_versions() -> dict[str, str]:
    """Versions of what computes the results."""
    return {name: version(name) for name in LIBRARIES}


def report_document(config: RunConfig, reports: list[StageReport]) -> dict[str, Any]:
    """Content of report.json."""
    return {
        "schema": 1,
        "run": config.run.name,
        "seed": config.run.seed,
        "libraries": library_versions(),
        "stages": [vars(report) for report in reports],
    }
