"""Progress on the terminal: a bar for each step of a stage, plain lines where it is no terminal.

It never stands still: bars count the seconds, plain lines come every ten seconds whether anything
advanced or not, and the compilation of kernels (minutes at the first run) is announced and counted.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Generator
from contextlib import contextmanager

from numba.core import event
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

PLAIN_INTERVAL_S = 10.0
SPEED_OVER_S = 600.0
"""Time left follows from the speed over so long: candidates and tiles differ much."""


class Counter:
    """One bar."""

    def __init__(self, bars: Progress, task: TaskID) -> None:
        self._bars = bars
        self._task = task

    def advance(self, steps: int = 1) -> None:
        """Count ``steps`` more as done."""
        self._bars.advance(self._task, steps)


class StageProgress:
    """The bars of one stage."""

    def __init__(self, bars: Progress, stage: str, compilation: _Compilation) -> None:
        self._bars = bars
        self._stage = stage
        self._compilation = compilation

    def start(self, label: str, total: int) -> Counter:
        """Begin a counter with ``total`` steps."""
        compiled_s = self._compilation.seconds
        task = self._bars.add_task(label, total=total, stage=self._stage, compiled_s=compiled_s)
        return Counter(self._bars, task)


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
        speed_estimate_period=SPEED_OVER_S,
    )
    ended = threading.Event()
    compilation = _Compilation(console, bars, stage)
    teller = threading.Thread(
        target=_tell, args=(console, bars, stage, compilation, ended), daemon=True
    )
    with bars, event.install_listener("numba:compile", compilation):
        if not console.is_terminal:
            teller.start()
        try:
            yield StageProgress(bars, stage, compilation)
        finally:
            ended.set()
            if teller.is_alive():
                teller.join()


def _tell(
    console: Console,
    bars: Progress,
    stage: str,
    compilation: _Compilation,
    ended: threading.Event,
) -> None:
    """Print a line now and then on how far a stage is."""
    began = time.monotonic()
    while not ended.wait(PLAIN_INTERVAL_S):
        text = f"  {stage}: {time.monotonic() - began:.0f} s"
        if compilation.doing:
            text += f"; {compilation.doing}"
        for task in bars.tasks:
            if not task.finished and task.total:
                text += f"; {task.description} {task.completed / task.total:.0%}"
                if task.completed and task.elapsed and not compilation.doing:
                    compiled_s = compilation.seconds - task.fields["compiled_s"]
                    left = (task.elapsed - compiled_s) * (task.total / task.completed - 1)
                    text += f", {left:.0f} s left"
        console.print(text, highlight=False)


class _Compilation(event.Listener):
    """Says what kernels are being compiled: those that are not kept on disk wait for it."""

    def __init__(self, console: Console, bars: Progress, stage: str) -> None:
        self._console = console
        self._bars = bars
        self._stage = stage
        self._task: TaskID | None = None
        self._kernels = 0
        self._under_way = 0
        self._began = 0.0
        self.seconds = 0.0
        """Spent so far: no measure of what is left to do."""
        self.doing = ""
        """In words; empty while nothing is compiled."""

    def on_start(self, event: event.Event) -> None:
        """One more kernel, perhaps for another one that waits for it."""
        if self._task is None:
            text = f"  {self._stage}: compiling kernels, once for this machine; a minute or two"
            self._console.print(text, highlight=False)
            self._task = self._bars.add_task("", total=None, stage=self._stage)
        self._kernels += 1
        if not self._under_way:
            self._began = time.monotonic()
        self._under_way += 1
        name = event.data["dispatcher"].py_func.__name__ if event.data else "kernel"
        self.doing = f"compiling kernel {self._kernels}, {name.lstrip('_')}"
        self._bars.update(self._task, description=self.doing, visible=True)

    def on_end(self, event: event.Event) -> None:  # noqa: ARG002 - numba's signature
        """The next kernel may follow at once."""
        self._under_way -= 1
        if not self._under_way and self._task is not None:
            self.doing = ""
            self.seconds += time.monotonic() - self._began
            self._bars.update(self._task, visible=False)
