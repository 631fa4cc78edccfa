"""Content keys and the plan that follows from them: what runs, what is reused, and why."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import trimesh

from spinpipe.pipeline.config import ConfigError, load_config
from spinpipe.pipeline.input_files import hash_path
from spinpipe.pipeline.keys import changed_parts, code_digest, producers, stage_key
from spinpipe.pipeline.plan import Step, make_plan
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.stages import STAGES
from spinpipe.stages.stage import StageError

if TYPE_CHECKING:
    from tests.conftest import YardRun

ROOT = Path(__file__).parents[3]
NAMES = [stage.name for stage in STAGES]


def plan(run: YardRun, *overrides: str, **limits: str | None) -> list[Step]:
    return make_plan(load_config(run.config, overrides), RunFolder(run.output), **limits)


def running(steps: list[Step]) -> list[str]:
    return [step.stage.name for step in steps if step.action == "run"]


def reason(steps: list[Step], stage: str) -> str:
    return next(step.reason for step in steps if step.stage.name == stage)


def test_a_finished_run_is_reused(finished_yard: YardRun) -> None:
    assert {step.action for step in plan(finished_yard)} == {"reuse"}


def test_an_empty_folder_runs_everything(finished_yard: YardRun, tmp_path: Path) -> None:
    steps = make_plan(load_config(finished_yard.config), RunFolder(tmp_path / "new"))
    assert running(steps) == NAMES
    assert {step.reason for step in steps} == {"no output yet"}
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("override", "first", "named"),
    [
        ("verify.icp.samples=400", "verify", "[verify.icp] samples"),
        ("cluster.min_hits=2", "cluster", "[cluster] min_hits"),
        ("scan.bin_m=0.25", "scan", "[scan] bin_m"),
        ("ground.min_margin=1.4", "ground", "[ground] min_margin"),
        ("ingest.scale=1.5", "ingest", "[ingest] scale"),
        ("verify.method=trimmed", "verify", "[verify] method"),
        ("run.seed=1", "ingest", "seed"),
    ],
)
def test_a_change_runs_its_stage_and_those_after_it(
    finished_yard: YardRun, override: str, first: str, named: str
) -> None:
    steps = plan(finished_yard, override)
    assert running(steps) == NAMES[NAMES.index(first) :]
    assert named in reason(steps, first)
    assert "changed" in reason(steps, first)


@pytest.mark.parametrize(
    "override",
    [
        "run.name=other",
        "execution.threads=1",
        "execution.memory_gb=2",
        "record.preview_points=1000",
    ],
)
def test_how_the_work_is_done_is_no_reason(finished_yard: YardRun, override: str) -> None:
    assert running(plan(finished_yard, override)) == []


def test_a_change_upstream_is_the_reason_downstream(finished_yard: YardRun) -> None:
    steps = plan(finished_yard, "scan.bin_m=0.25")
    assert "scan" in reason(steps, "cluster")


def test_a_changed_constant_runs_the_stage_again(finished_yard: YardRun, tmp_path: Path) -> None:
    """With the program itself, from a copy of its folders."""
    for folder in ("schemas", "stages", "pipeline"):
        shutil.copytree(ROOT / folder, tmp_path / "spinpipe" / folder)
    suppression = tmp_path / "spinpipe" / "stages" / "cluster" / "suppression.py"
    text = suppression.read_text()

    def plan_lines() -> list[str]:
        command = "from spinpipe.pipeline.entry import main; main()"
        done = subprocess.run(
            [
                sys.executable,
                "-c",
                command,
                "plan",
                finished_yard.config,
                "-o",
                finished_yard.output,
            ],
            env=os.environ | {"PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        lines = [line.rstrip() for line in done.stdout.splitlines()]
        return [line for line in lines if re.match(r"\w+ +(run|reuse)\b", line)]

    suppression.write_text(f"# a comment\n{text}")
    assert {line.split()[1] for line in plan_lines()} == {"reuse"}
    suppression.write_text(f"{text}\n_ANOTHER = 1\n")
    *before, cluster, verify = plan_lines()
    assert {line.split()[1] for line in before} == {"reuse"}
    assert cluster.split(maxsplit=2) == ["cluster", "run", "code of cluster changed"]
    assert verify.split(maxsplit=2) == ["verify", "run", "cluster changed"]


CODE = """
class Scan:
    {doc}
    threshold_m = {number}

    def run(self):
        {doc}
        return {text}
"""


def test_code_is_known_by_what_it_does(tmp_path: Path) -> None:
    def digest(number: str = "0.6", doc: str = '"""Scan."""', text: str = '"found"') -> str:
        file = tmp_path / f"{len(list(tmp_path.iterdir()))}" / "scan.py"
        file.parent.mkdir()
        file.write_text(CODE.format(number=number, doc=doc, text=text))
        return code_digest(file)

    assert digest() == digest(doc='"""Said in other words."""') == digest(number="0.6  # [paper]")
    assert len({digest(), digest(number="0.7"), digest(text='"lost"')}) == 3


def test_touching_or_moving_an_input_is_no_reason(yard_run: YardRun) -> None:
    os.utime(yard_run.folder / "scene.ply", (0, 0))
    assert running(plan(yard_run)) == []
    (yard_run.folder / "elsewhere").mkdir()
    moved = shutil.move(yard_run.folder / "scene.ply", yard_run.folder / "elsewhere" / "lot.ply")
    assert running(plan(yard_run, f"ingest.scene={moved}")) == []


def test_another_model_costs_neither_import_nor_ground(finished_yard: YardRun) -> None:
    steps = plan(finished_yard, "model.saloon.stretch=0.1")
    assert running(steps) == ["model", "scan", "cluster", "verify"]
    assert reason(steps, "model") == "[[model]] 'saloon' stretch changed from 0.0 to 0.1"
    assert reason(steps, "scan") == "model changed"


@pytest.mark.parametrize(
    ("name", "first", "key"),
    [("scene.ply", "ingest", "[ingest] scene"), ("saloon.ply", "model", "[[model]] 'saloon' path")],
)
def test_one_changed_byte_of_an_input_runs_what_reads_it(
    yard_run: YardRun, name: str, first: str, key: str
) -> None:
    path = yard_run.folder / name
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    steps = plan(yard_run)
    assert running(steps) == [
        n for n in NAMES[NAMES.index(first) :] if (first, n) != ("model", "ground")
    ]
    assert reason(steps, first) == f"{key} changed"


def test_a_missing_input_is_named(yard_run: YardRun) -> None:
    (yard_run.folder / "scene.ply").unlink()
    with pytest.raises(StageError, match=r"scene\.ply"):
        plan(yard_run)


@pytest.mark.parametrize("stage", NAMES)
def test_from_runs_a_stage_and_all_after_it(finished_yard: YardRun, stage: str) -> None:
    assert running(plan(finished_yard, start=stage)) == NAMES[NAMES.index(stage) :]


@pytest.mark.parametrize("stage", NAMES)
def test_until_skips_what_comes_after(finished_yard: YardRun, stage: str) -> None:
    steps = plan(finished_yard, "ingest.scale=1.5", until=stage)
    assert running(steps) == NAMES[: NAMES.index(stage) + 1]
    assert {s.action for s in steps[NAMES.index(stage) + 1 :]} <= {"skip"}


def test_from_and_until_meet_in_one_stage(finished_yard: YardRun) -> None:
    assert running(plan(finished_yard, start="scan", until="scan")) == ["scan"]


def test_impossible_limits_are_refused(finished_yard: YardRun) -> None:
    with pytest.raises(ConfigError, match="--from verify comes after --until scan"):
        plan(finished_yard, start="verify", until="scan")
    with pytest.raises(ConfigError, match="--until scna: no such stage; stages are ingest"):
        plan(finished_yard, until="scna")


def test_left_overs_of_a_killed_run_are_noticed(yard_run: YardRun) -> None:
    path = yard_run.mcap("scan")
    path.rename(path.with_suffix(".mcap.partial"))
    assert "interrupted" in reason(plan(yard_run), "scan")


def test_every_input_has_one_producer_before_it() -> None:
    for i, stage in enumerate(STAGES):
        assert set(producers(stage)) <= set(NAMES[:i])
        for topic in stage.inputs:
            assert sum(topic in other.outputs for other in STAGES) == 1


def test_a_key_depends_on_every_part_and_not_on_their_order() -> None:
    assert stage_key({"a": "1", "b": "2"}) == stage_key({"b": "2", "a": "1"})
    assert stage_key({"a": "1"}) != stage_key({"a": "2"}) != stage_key({"b": "1"})
    assert changed_parts({"a": "1", "b": "2", "d": "4"}, {"a": "1", "b": "3", "c": "4"}) == [
        "b",
        "c",
        "d",
    ]


def test_a_folder_is_known_by_names_and_contents(tmp_path: Path) -> None:
    folder = tmp_path / "model"
    (folder / "sub").mkdir(parents=True)
    (folder / "a.bin").write_bytes(b"1")
    (folder / "sub" / "b.bin").write_bytes(b"2")
    before = hash_path(folder, "ingest.scene")
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    assert hash_path(copy, "ingest.scene") == before
    (copy / "sub" / "b.bin").write_bytes(b"3")
    assert hash_path(copy, "ingest.scene") != before
    (folder / "sub" / "b.bin").rename(folder / "sub" / "c.bin")
    assert hash_path(folder, "ingest.scene") != before


def test_of_photos_in_a_folder_the_head_and_the_size_count(tmp_path: Path) -> None:
    photo = tmp_path / "a.JPG"
    photo.write_bytes(b"exif" + bytes(1 << 18) + b"pixels")
    before = hash_path(tmp_path, "ingest.photos")
    photo.write_bytes(b"exif" + bytes(1 << 18) + b"PIXELS")
    assert hash_path(tmp_path, "ingest.photos") == before
    alone = hash_path(photo, "ingest.scene")
    for content in (b"EXIF" + bytes(1 << 18) + b"pixels", b"exif" + bytes(1 << 18) + b"pixel"):
        photo.write_bytes(content)
        assert hash_path(tmp_path, "ingest.photos") != before
        assert hash_path(photo, "ingest.scene") != alone


def test_a_gltf_is_known_by_its_buffers_too(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        trimesh.creation.box().export(tmp_path / name / "crate.gltf")
    buffers = sorted((tmp_path / "two").glob("*.bin"))
    before = hash_path(tmp_path / "one" / "crate.gltf", "model.crate.path")
    gltf = tmp_path / "two" / "crate.gltf"
    assert hash_path(gltf, "model.crate.path") == before
    for buffer in buffers:
        content = buffer.read_bytes()
        buffer.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
        assert hash_path(gltf, "model.crate.path") != before
        buffer.write_bytes(content)
    assert hash_path(gltf, "model.crate.path") == before
    buffers[0].unlink()
    with pytest.raises(StageError, match=f"cannot read its buffer '{buffers[0].name}'"):
        hash_path(gltf, "model.crate.path")


@pytest.mark.parametrize("content", ["solid", "[]", '{"buffers": [1]}'])
def test_a_file_that_is_no_gltf_has_no_key(tmp_path: Path, content: str) -> None:
    path = tmp_path / "crate.gltf"
    path.write_text(content)
    with pytest.raises(StageError, match=r"crate\.gltf: not a glTF file"):
        hash_path(path, "model.crate.path")


def test_buffers_within_a_gltf_need_no_file(tmp_path: Path) -> None:
    path = tmp_path / "crate.gltf"
    path.write_text('{"buffers": [{"uri": "data:application/octet-stream;base64,AAAA"}, {}]}')
    assert hash_path(path, "model.crate.path").endswith(".gltf")
