"""Progress on the terminal: a bar for each step of a stage, plain lines where it is no terminal.

It never stands still: bars count the seconds, plain lines come every ten seconds whether anything
advanced or not, and the compilation of kernels (a minute at the first run) is announced.
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

    def __init__(self, bars: Progress, stage: str) -> None:
        self._bars = bars
        self._stage = stage

    def start(self, label: str, total: int) -> Counter:
        """Begin a counter with ``total`` steps."""
        return Counter(self._bars, self._bars.add_task(label, total=total, stage=self._stage))


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
    teller = threading.Thread(target=_tell, args=(console, bars, stage, ended), daemon=True)
    with bars, event.install_listener("numba:compile", _Compilation(console, stage)):
        if not console.is_terminal:
            teller.start()
        try:
            yield StageProgress(bars, stage)
        finally:
            ended.set()
            if teller.is_alive():
                teller.join()


def _tell(console: Console, bars: Progress, stage: str, ended: threading.Event) -> None:
    """Print a line now and then on how far a stage is."""
    began = time.monotonic()
    while not ended.wait(PLAIN_INTERVAL_S):
        text = f"  {stage}: {time.monotonic() - began:.0f} s"
        for task in bars.tasks:
            if not task.finished and task.total:
                text += f"; {task.description} {task.completed / task.total:.0%}"
                if task.completed and task.elapsed:
                    left = task.elapsed * (task.total / task.completed - 1)
                    text += f", {left:.0f} s left"
        console.print(text, highlight=False)


class _Compilation(event.Listener):
    """Says once a stage that kernels are being compiled."""

    def __init__(self, console: Console, stage: str) -> None:
        self._console = console
        self._stage = stage
        self._told = False

    def on_start(self, event: event.Event) -> None:  # noqa: ARG002 - numba's signature
        """A kernel that is not kept on disk yet: its first call waits for the compiler."""
        if not self._told:
            self._told = True
            text = f"  {self._stage}: compiling kernels, once for this machine; up to a minute"
            self._console.print(text, highlight=False)

    def on_end(self, event: event.Event) -> None:
        """Nothing: the next kernel may follow at once."""
