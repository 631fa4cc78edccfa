"""A reader that dies, hangs or grows ends in a sentence, and only its own process with it."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import laspy
import numpy as np
import pytest

from spinpipe.stages.ingest.readers import guarded as module
from spinpipe.stages.ingest.readers.guarded import guarded
from spinpipe.stages.ingest.readers.open_scene import open_scene
from spinpipe.stages.stage import StageError


def reader(path: Path, how: str) -> Iterator[np.ndarray]:
    yield np.arange(3)
    match how:
        case "abort":
            os.abort()
        case "hang":
            while True:
                pass
        case "wait":
            threading.Event().wait()
        case "grow":
            np.ones(1 << 40)
        case "refuse":
            raise StageError(f"{path}: no")
        case _:
            yield np.arange(4)


def children() -> set[str]:
    """Processes that this one started; a test before this one may have left its own."""
    tasks = Path("/proc/self/task").iterdir()
    return {child for task in tasks for child in (task / "children").read_text().split()}


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("abort", "broke down"),
        ("hang", "found nothing in"),
        ("wait", "stood still for"),
        ("grow", "more memory than its size"),
        ("refuse", "no"),
    ],
)
def test_whatever_a_reader_does_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str, said: str
) -> None:
    monkeypatch.setattr(module, "STEP_S", 0.2)
    monkeypatch.setattr(module, "STILL_S", 0.5)
    path = tmp_path / "file"
    path.write_bytes(b"x")
    results = guarded(reader, path, how)
    assert len(next(results)) == 3
    with pytest.raises(StageError, match=said):
        next(results)


def test_all_results_come_in_order_and_no_child_stays(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x")
    before = children()
    assert [len(x) for x in guarded(reader, path, "")] == [3, 4]
    results = guarded(reader, path, "hang")
    next(results)
    assert len(children() - before) == 1
    results.close()
    assert children() <= before


def test_hostile_clouds_are_refused_or_read(shared_data: Path) -> None:
    hostile = shared_data.parent / "cases" / "hostile"
    with pytest.raises(StageError, match="min_hang_vlrs"):
        list(open_scene(hostile / "min_hang_vlrs.las").chunks(1000))
    # a byte of its table of pieces is wrong, which aborts who reads these side by side
    chunks = open_scene(hostile / "min_abort.laz").chunks(1000)
    assert sum(len(xyz) for xyz, _ in chunks) == 300


def test_laz_is_read_after_laspy_has_used_its_threads(tmp_path: Path) -> None:
    """They do not live on in a child, which then waits for them for good."""
    cloud = laspy.create(point_format=0)
    cloud.header.scales = np.full(3, 0.001)
    cloud.xyz = np.random.default_rng(0).random((300_000, 3))
    cloud.write(tmp_path / "cloud.laz", laz_backend=laspy.LazBackend.LazrsParallel)
    chunks = open_scene(tmp_path / "cloud.laz").chunks(50_000)
    assert sum(len(xyz) for xyz, _ in chunks) == 300_000
