"""Progress where there is no terminal: it goes on while nothing advances."""

from __future__ import annotations

import io
import re
import time

import pytest
from numba import njit
from numba.core import event
from rich.console import Console

from spinpipe.pipeline import progress


def test_a_line_comes_even_if_nothing_advances(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "PLAIN_INTERVAL_S", 0.02)
    said = io.StringIO()
    with progress.stage_progress(Console(file=said), "verify") as bars:
        counter = bars.start("candidates", 40)
        time.sleep(0.1)
        counter.advance(10)
        time.sleep(0.1)
    lines = said.getvalue().splitlines()
    assert len(lines) >= 2
    assert "verify" in lines[0]
    assert "candidates 0%" in lines[0]
    assert "candidates 25%" in lines[-1]
    assert "s left" in lines[-1]


def test_compilation_is_announced_once_a_stage() -> None:
    said = io.StringIO()
    with progress.stage_progress(Console(file=said), "scan"):
        njit(lambda x: 2 * x)(1.0)
        njit(lambda x: 3 * x)(1.0)
    assert said.getvalue().count("compiling kernels") == 1


def test_compilation_is_counted_kernel_by_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "PLAIN_INTERVAL_S", 0.005)
    said = io.StringIO()

    def doubled(x: float) -> float:
        return 2 * x

    with progress.stage_progress(Console(file=said), "scan") as bars:
        bars.start("tiles", 3)
        njit(doubled)(1.0)
        time.sleep(0.05)
    lines = said.getvalue().splitlines()
    assert any("; compiling kernel 1, doubled; tiles 0%" in line for line in lines)
    assert "compiling" not in lines[-1]


def test_compiling_does_not_count_for_the_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "PLAIN_INTERVAL_S", 0.1)
    said = io.StringIO()
    with progress.stage_progress(Console(file=said), "scan") as bars:
        counter = bars.start("tiles", 100)
        with event.trigger_event("numba:compile"):
            time.sleep(1.0)
        counter.advance(10)
        time.sleep(0.15)
    left = re.findall(r"tiles 10%, (\d+) s left", said.getvalue())
    assert left
    assert int(left[0]) < 5  # 9 with that second


def test_nothing_is_said_about_a_quiet_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "PLAIN_INTERVAL_S", 0.02)
    said = io.StringIO()
    with progress.stage_progress(Console(file=said, quiet=True), "scan") as bars:
        bars.start("origins", 3)
        time.sleep(0.1)
    assert said.getvalue() == ""
