"""A reader that dies, hangs or grows ends in a sentence, and only its own process with it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from spinpipe.stages.ingest import guarded as module
from spinpipe.stages.ingest.guarded import guarded
from spinpipe.stages.stage import StageError


def reader(path: Path, how: str) -> Iterator[np.ndarray]:
    yield np.arange(3)
    match how:
        case "abort":
            os.abort()
        case "hang":
            while True:
                pass
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
        ("grow", "more memory than its size"),
        ("refuse", "no"),
    ],
)
def test_whatever_a_reader_does_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str, said: str
) -> None:
    monkeypatch.setattr(module, "STEP_S", 0.2)
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


@pytest.mark.parametrize("name", ["min_hang_vlrs.las", "min_abort.laz"])
def test_hostile_clouds_are_refused(shared_data: Path, name: str) -> None:
    from spinpipe.stages.ingest.open_scene import open_scene

    path = shared_data.parent / "cases" / "hostile" / name
    with pytest.raises(StageError, match=name):
        list(open_scene(path).chunks(1000))
