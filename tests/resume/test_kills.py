"""Processes of their own that really die: nothing that was finished is lost."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import numpy as np
from tests.resume.going_on import NAMES, actions, assert_same_results, go_on

from spinpipe.pipeline.mcap_file import check

if TYPE_CHECKING:
    from tests.conftest import Cli, YardRun


def heed_ctrl_c() -> None:
    """A shell that puts the tests in the background lets its children ignore SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def start(run: YardRun) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [
            *(sys.executable, "-c", "from spinpipe.pipeline.entry import main; main()"),
            *("run", str(run.config), "--rerun", "off", "-o", str(run.output)),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heed_ctrl_c,
    )


def wait_for(run: YardRun, name: str, process: subprocess.Popen[str]) -> None:
    """Wait until a file is there, or the process has ended."""
    while process.poll() is None and not (run.output / name).exists():
        time.sleep(0.002)


def test_kills_at_random_moments_cost_nothing_that_was_finished(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    rng = np.random.default_rng(int.from_bytes(os.urandom(4), "little"))
    shutil.rmtree(yard_run.output)
    finished: set[str] = set()
    for stage in ("ingest", "ground", "scan", "verify"):
        name = finished_yard.mcap(stage).name
        process = start(yard_run)
        wait_for(yard_run, f"{name}.partial", process)
        time.sleep(rng.uniform(0, 0.3))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        there = {path.name for path in yard_run.output.glob("*.mcap")}
        assert finished <= there, f"a kill in {stage} lost a finished stage"
        for path in yard_run.output.glob("*.mcap"):
            check(path)
        finished = there
    outcome = go_on(cli, yard_run)
    reused = {stage for stage, action in actions(outcome).items() if action == "reuse"}
    assert {yard_run.mcap(stage).name for stage in reused} == finished
    assert_same_results(yard_run, finished_yard)


def test_ctrl_c_ends_quietly_and_the_next_run_goes_on(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    for stage in NAMES[1:]:
        yard_run.mcap(stage).unlink()
    process = start(yard_run)
    wait_for(yard_run, "03_ground.mcap.partial", process)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "spinpipe: interrupted; run it again to go on"
    assert actions(go_on(cli, yard_run))["ingest"] == "reuse"
    assert_same_results(yard_run, finished_yard)


def test_two_processes_do_not_spoil_each_other(finished_yard: YardRun, yard_run: YardRun) -> None:
    shutil.rmtree(yard_run.output)
    ends = [(p, p.communicate()) for p in [start(yard_run), start(yard_run)]]
    codes = sorted(process.returncode for process, _ in ends)
    assert codes == [0, 1]
    loser = next(err for process, (_, err) in ends if process.returncode == 1)
    assert "another spinpipe works in this folder" in loser
    assert_same_results(yard_run, finished_yard)
