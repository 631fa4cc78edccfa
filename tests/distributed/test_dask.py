"""The Dask engine against a real cluster of processes over loopback."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path

import pytest

distributed = pytest.importorskip("distributed", reason="the extra 'dask' is not installed")

from spinpipe.pipeline import engine  # noqa: E402
from spinpipe.pipeline.commands import execute  # noqa: E402
from spinpipe.pipeline.config import load_config  # noqa: E402
from spinpipe.pipeline.context import RunReader  # noqa: E402
from spinpipe.pipeline.demo import DEMO_CONFIG, write_example  # noqa: E402
from spinpipe.pipeline.errors import describe  # noqa: E402
from spinpipe.pipeline.run_folder import RunFolder  # noqa: E402
from spinpipe.schemas import HITS  # noqa: E402


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=None,
        silence_logs=50,
    ) as cluster:
        yield cluster


def run(example: Path, folder: Path, *overrides: str) -> RunFolder:
    config = load_config(
        example / "config.toml",
        ["ingest.tile_points=2048", *overrides],
    )
    target = RunFolder(folder)
    execute(config, target, None, "verify", "off")
    return target


def results(folder: RunFolder) -> tuple[str, bytes]:
    hits = RunReader(folder)(HITS)[0]
    return json.dumps(json.loads(folder.detections_json.read_text())), (
        hits.points.tobytes() + hits.correlation.tobytes()
    )


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("example")
    write_example(folder, points=60_000)
    (folder / "config.toml").write_text(DEMO_CONFIG)
    return folder


@pytest.fixture(scope="module")
def local(example: Path, tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return run(example, tmp_path_factory.mktemp("local"))


def dask_options(cluster) -> tuple[str, str]:
    return "execution.engine=dask", f"execution.scheduler={cluster.scheduler_address}"


def test_a_cluster_gives_what_one_machine_gives(cluster, example, local, tmp_path):
    assert results(run(example, tmp_path, *dask_options(cluster))) == results(local)


def test_a_worker_killed_in_the_middle_costs_nothing(cluster, example, local, tmp_path):
    victim = cluster.workers[0].pid
    scan = RunFolder(tmp_path).partial("scan")

    def kill() -> None:
        while not (scan.exists() and scan.stat().st_size > 400_000):
            time.sleep(0.005)
        os.kill(victim, signal.SIGKILL)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    folder = run(example, tmp_path, *dask_options(cluster))
    killer.join(timeout=10)
    assert not killer.is_alive(), "the scan ended before the worker could be killed"
    assert results(folder) == results(local)


def test_no_scheduler_is_one_clear_line(example, tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "CONNECT_TIMEOUT_S", 1)
    with pytest.raises(Exception, match="no Dask scheduler answers") as error:
        run(
            example,
            tmp_path,
            "execution.engine=dask",
            "execution.scheduler=tcp://127.0.0.1:9",
        )
    text, code = describe(error.value)
    assert "\n" not in text
    assert code == 1
