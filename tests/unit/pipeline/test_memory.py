"""``memory_gb`` and ``threads`` mean the process: told before a run, kept in it, given back."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest
from threadpoolctl import threadpool_info

from spinpipe.pipeline.config import ConfigError, ExecutionSection, load_config
from spinpipe.pipeline.engine import open_engine
from spinpipe.pipeline.memory import fitting_threads

if TYPE_CHECKING:
    from tests.conftest import Cli, YardRun

CHILD = """
import json, os, resource, sys
from pathlib import Path
from spinpipe.pipeline.commands import run_command

def held():
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return len(os.listdir("/proc/self/task")), pages * resource.getpagesize()

config, output, memory_gb = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
common = [f"execution.memory_gb={memory_gb}", "execution.threads=2"]
run_command(config, output, common, "ingest", None, "save", False)
# ru_maxrss would be that of the process that started this one, if it was larger
status = Path("/proc/self/status").read_text()
peak = 1024 * int(next(line for line in status.splitlines() if "VmHWM" in line).split()[1])
seen = []
for points in range(7):
    more = [*common, f"record.preview_points={1000 + points}"]
    run_command(config, output, more, None, "ingest", "save", False)
    seen.append(held())
print(json.dumps([peak, seen]))
"""


def threads(run: YardRun, *overrides: str, recording: bool = False) -> int:
    return fitting_threads(load_config(run.config, overrides), recording=recording)


def test_fewer_threads_where_more_do_not_fit(finished_yard: YardRun) -> None:
    wanted = ("execution.threads=64", "ingest.tile_points=262144")
    assert threads(finished_yard, *wanted, "execution.memory_gb=64") == 64
    assert 1 < threads(finished_yard, *wanted, "execution.memory_gb=4") < 64
    assert threads(finished_yard, *wanted, "execution.memory_gb=0.6") == 2


def test_a_run_that_does_not_fit_says_what_it_needs(finished_yard: YardRun, cli: Cli) -> None:
    with pytest.raises(ConfigError, match=r"may take 0\.83 GB.*--rerun off"):
        threads(finished_yard, "execution.memory_gb=0.8", recording=True)
    outcome = cli("run", finished_yard.config, "--rerun", "off",
                  "--set", "execution.memory_gb=0.25")  # fmt: skip
    assert outcome.code == 2
    assert outcome.err.startswith("spinpipe: execution.memory_gb = 0.25: this run may take 0.53 GB")
    assert outcome.err.count("\n") == 1


def test_a_process_stays_below_it_and_does_not_grow(yard_run: YardRun) -> None:
    """The issue's figure was six threads and 6 MB more with every recording."""
    arguments = [sys.executable, "-c", CHILD, str(yard_run.config), str(yard_run.output)]
    done = subprocess.run([*arguments, "0.84"], capture_output=True, text=True, check=True)
    peak, seen = json.loads(done.stdout.splitlines()[-1])
    assert peak < 0.84e9
    counts, sizes = zip(*seen, strict=True)
    assert counts[-1] <= counts[2]
    assert sizes[-1] - sizes[2] < 20e6


def test_libraries_do_not_multiply_the_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAYON_NUM_THREADS", raising=False)
    with open_engine(ExecutionSection(), 2) as engine:
        assert engine.threads == 2
        assert os.environ["RAYON_NUM_THREADS"] == "2"
        assert {pool["num_threads"] for pool in threadpool_info()} == {1}
    assert "RAYON_NUM_THREADS" not in os.environ
