"""Progress on the terminal: a bar for each step of a stage, plain lines where it is no terminal."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

_PLAIN_INTERVAL_S = 10.0


class Counter:
    """One bar; without a terminal a line every ten seconds."""

    def __init__(self, bars: Progress, task: TaskID, label: str) -> None:
        self._bars = bars
        self._task = task
        self._label = label
        self._last = time.monotonic()

    def advance(self, steps: int = 1) -> None:
        """Count ``steps`` more as done."""
        self._bars.advance(self._task, steps)
        now = time.monotonic()
        if not self._bars.console.is_terminal and now - self._last > _PLAIN_INTERVAL_S:
            self._last = now
            task = self._bars.tasks[self._bars.task_ids.index(self._task)]
            share = task.completed / task.total if task.total else 1.0
            self._bars.console.print(f"  {self._label}: {share:.0%}", highlight=False)


class StageProgress:
    """The bars of one stage."""

    def __init__(self, bars: Progress, stage: str) -> None:
        self._bars = bars
        self._stage = stage

    def start(self, label: str, total: int) -> Counter:
        """Begin a counter with ``total`` steps."""
        task = self._bars.add_task(label, total=total, stage=self._stage)
        return Counter(self._bars, task, f"{self._stage}: {label}")


@contextmanager
def stage_progress(console: Console, stage: str) -> Generator[StageProgress]:
    """Show the bars of one stage while it runs."""
    bars = Progress(
        TextColumn("  {task.fields[stage]:<8}"),
        TextColumn("{task.description:<10}"),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    with bars:
        yield StageProgress(bars, stage)
