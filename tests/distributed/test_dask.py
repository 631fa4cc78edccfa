"""The Dask engine against a real cluster of processes over loopback."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.resume.going_on import assert_same_results, ran

distributed = pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
dask_config = pytest.importorskip("dask.config")
distributed_utils = pytest.importorskip("distributed.utils")

from spinpipe.pipeline import engine  # noqa: E402
from spinpipe.pipeline.commands import execute  # noqa: E402
from spinpipe.pipeline.config import load_config  # noqa: E402
from spinpipe.pipeline.errors import describe  # noqa: E402
from spinpipe.pipeline.run_folder import RunFolder  # noqa: E402

if TYPE_CHECKING:
    from tests.conftest import Cli, YardRun


@pytest.fixture(scope="module")
def cluster():
    dask_config.set({"distributed.worker.multiprocessing-method": "forkserver"})
    # imported once, by the process that workers are forked from
    distributed_utils.get_mp_context().set_forkserver_preload(["distributed", "spinpipe.stages"])
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=None,
        silence_logs=50,
    ) as cluster:
        yield cluster


def from_scan_on(cli: Cli, yard_run: YardRun, cluster: Any) -> None:
    """Run a yard's stages from the scan on on a cluster."""
    options = ("engine=dask", f"scheduler={cluster.scheduler_address}")
    overrides = (word for option in options for word in ("--set", f"execution.{option}"))
    run = ("run", yard_run.config, "-o", yard_run.output, "--rerun", "off", "--from", "scan")
    assert ran(cli(*run, *overrides)) == ["scan", "cluster", "verify"]


def test_a_cluster_gives_what_one_machine_gives(cli, cluster, finished_yard, yard_run):
    from_scan_on(cli, yard_run, cluster)
    assert_same_results(yard_run, finished_yard)


def test_a_worker_killed_in_the_middle_costs_nothing(cli, cluster, finished_yard, yard_run):
    victim = cluster.workers[0].pid
    scan = RunFolder(yard_run.output).partial("scan")
    middle = yard_run.mcap("scan").stat().st_size / 4

    def kill() -> None:
        while not (scan.exists() and scan.stat().st_size > middle):
            time.sleep(0.002)
        os.kill(victim, signal.SIGKILL)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    from_scan_on(cli, yard_run, cluster)
    killer.join(timeout=10)
    assert not killer.is_alive(), "the scan ended before the worker could be killed"
    assert_same_results(yard_run, finished_yard)


def test_no_scheduler_is_one_clear_line(
    finished_yard: YardRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "CONNECT_TIMEOUT_S", 1)
    options = ("execution.engine=dask", "execution.scheduler=tcp://127.0.0.1:9")
    config = load_config(finished_yard.config, options)
    with pytest.raises(Exception, match="no Dask scheduler answers") as error:
        execute(config, RunFolder(tmp_path), None, "verify", "off")
    text, code = describe(error.value)
    assert "\n" not in text
    assert code == 1
