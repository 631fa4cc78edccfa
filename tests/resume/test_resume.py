"""A run goes on from where it stopped, notices every damage, and always ends the same."""

from __future__ import annotations

import fcntl
import itertools
import os
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.resume.going_on import (
    NAMES,
    RESULTS,
    assert_same_results,
    content,
    go_on,
    left_overs,
    ran,
)

from spinpipe.pipeline import commands, mcap_file
from spinpipe.pipeline.config import ExecutionSection, load_config
from spinpipe.pipeline.engine import Engine, open_engine
from spinpipe.pipeline.mcap_file import StageFileWriter
from spinpipe.pipeline.plan import make_plan
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.runner import Runner
from spinpipe.schemas.topics import Topic

if TYPE_CHECKING:
    from tests.conftest import Cli, YardRun


on_a_copy = settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])


def test_a_second_run_reuses_everything_and_touches_nothing(cli: Cli, yard_run: YardRun) -> None:
    before = {stage: yard_run.mcap(stage).stat().st_mtime_ns for stage in NAMES}
    assert ran(go_on(cli, yard_run)) == []
    assert {stage: yard_run.mcap(stage).stat().st_mtime_ns for stage in NAMES} == before


def test_two_runs_give_the_same_bytes(cli: Cli, finished_yard: YardRun, yard_run: YardRun) -> None:
    shutil.rmtree(yard_run.output)
    assert ran(go_on(cli, yard_run)) == NAMES
    assert_same_results(yard_run, finished_yard)


def test_threads_and_memory_change_no_byte(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    go_on(
        cli,
        yard_run,
        *("--from", "ingest"),
        *("--set", "execution.threads=1"),  # the other run took as many as there are cores
        *("--set", "execution.memory_gb=1"),
    )
    assert_same_results(yard_run, finished_yard)


def test_only_verify_runs_when_only_verify_changes(cli: Cli, yard_run: YardRun) -> None:
    outcome = go_on(cli, yard_run, "--set", "verify.icp.samples=400")
    assert ran(outcome) == ["verify"]
    assert "[verify.icp] samples changed" in outcome.out


def test_a_changed_input_runs_everything_and_a_touched_one_nothing(
    cli: Cli, yard_run: YardRun
) -> None:
    scene = yard_run.folder / "scene.ply"
    os.utime(scene, (0, 0))
    assert ran(go_on(cli, yard_run)) == []
    data = bytearray(scene.read_bytes())
    data[-9] ^= 1  # the last bit of a coordinate
    scene.write_bytes(data)
    outcome = go_on(cli, yard_run)
    assert ran(outcome) == NAMES
    assert "[ingest] scene changed" in outcome.out


def test_going_back_to_an_old_setting_runs_again_and_ends_the_same(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    assert ran(go_on(cli, yard_run, "--set", "cluster.min_hits=4")) == ["cluster", "verify"]
    assert ran(go_on(cli, yard_run)) == ["cluster", "verify"]
    assert_same_results(yard_run, finished_yard)


def test_until_stops_and_the_next_run_goes_on(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    shutil.rmtree(yard_run.output)
    outcome = go_on(cli, yard_run, "--until", "ground")
    assert ran(outcome) == ["ingest", "model", "ground"]
    assert "stopped after ground" in outcome.out
    assert not (yard_run.output / "detections.json").exists()
    assert ran(go_on(cli, yard_run)) == ["scan", "cluster", "verify"]
    assert_same_results(yard_run, finished_yard)


def test_from_forces_a_stage_and_all_after_it(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    assert ran(go_on(cli, yard_run, "--from", "cluster")) == ["cluster", "verify"]
    assert_same_results(yard_run, finished_yard)


def test_a_file_that_another_run_replaced_is_not_reused(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun, tmp_path: Path
) -> None:
    """Another process may finish between the plan and the work."""
    other = finished_yard.copy(tmp_path / "other")
    go_on(cli, other, "--set", "scan.bin_m=0.25")

    @contextmanager
    def late(engine: ExecutionSection, cores: int) -> Generator[Engine]:
        shutil.copy(other.mcap("scan"), yard_run.mcap("scan"))
        with open_engine(engine, cores) as opened:
            yield opened

    with mock.patch.object(commands, "open_engine", late):
        outcome = go_on(cli, yard_run, "--from", "verify")
    assert outcome.code == 1
    assert "04_scan.mcap: was changed meanwhile" in outcome.err
    go_on(cli, yard_run)
    assert_same_results(yard_run, finished_yard)


def test_until_does_not_leave_results_of_other_settings(cli: Cli, yard_run: YardRun) -> None:
    """Results beside stages that they do not follow from would be taken for theirs."""
    outcome = go_on(cli, yard_run, "--set", "scan.bin_m=0.25", "--until", "scan")
    assert ran(outcome) == ["scan"]
    assert not any((yard_run.output / name).exists() for name in RESULTS)


@pytest.mark.parametrize("stage", NAMES)
def test_a_lost_file_is_made_again(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun, stage: str
) -> None:
    yard_run.mcap(stage).unlink()
    assert ran(go_on(cli, yard_run)) == [stage]
    assert_same_results(yard_run, finished_yard)


@pytest.mark.parametrize("stage", NAMES)
@on_a_copy
@given(data=st.data())
def test_a_flipped_bit_anywhere_is_noticed(
    yard_run: YardRun, stage: str, data: st.DataObject
) -> None:
    path = yard_run.mcap(stage)
    original = path.read_bytes()
    offset = data.draw(st.integers(0, len(original) - 1), label="offset")
    damaged = bytearray(original)
    damaged[offset] ^= 1 << data.draw(st.integers(0, 7), label="bit")
    path.write_bytes(damaged)
    steps = make_plan(load_config(yard_run.config), RunFolder(yard_run.output))
    path.write_bytes(original)
    assert [step.action for step in steps if step.stage.name == stage] == ["run"]


@pytest.mark.parametrize(
    ("stage", "share"),
    [("ingest", 0.5), ("scan", 0.0), ("scan", 0.999), ("verify", 0.01), ("verify", 0.999)],
)
def test_a_truncated_file_is_made_again(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun, stage: str, share: float
) -> None:
    path = yard_run.mcap(stage)
    os.truncate(path, int(share * path.stat().st_size))
    outcome = go_on(cli, yard_run)
    assert ran(outcome) == [stage]
    assert path.name in outcome.out
    assert_same_results(yard_run, finished_yard)


def flip(path: Path, offset: int, bit: int = 0) -> None:
    data = bytearray(path.read_bytes())
    data[offset] ^= 1 << bit
    path.write_bytes(data)


@pytest.mark.parametrize("stage", ["model", "scan", "verify"])
def test_a_damaged_later_file_does_not_stop_a_run_that_draws(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun, stage: str
) -> None:
    """The recording of an earlier stage must not look at what is about to be made anew."""
    path = yard_run.mcap(stage)
    os.truncate(path, path.stat().st_size // 2)
    outcome = cli("run", yard_run.config, "-o", yard_run.output)
    assert ran(outcome) == [stage]
    assert_same_results(yard_run, finished_yard)


@pytest.mark.parametrize("command", ["eval", "cut", "record", "plant"])
def test_no_command_reads_damaged_metadata(cli: Cli, yard_run: YardRun, command: str) -> None:
    """Metadata records have no checksum of their own: only that of the file tells."""
    path = yard_run.mcap("ground" if command == "cut" else "verify")
    flip(path, path.read_bytes().index(b"begin_ns", 60) + 13)
    truth = yard_run.folder / "truth.csv"
    truth.write_text("x,y\n-3.1,-2.6\n")
    cut = ("model", "cut", yard_run.output, "--at", "3,2.7,0", "--size", "5,2.5,2")
    outcome = {
        "eval": lambda: cli("eval", yard_run.output, "--truth", truth),
        "cut": lambda: cli(*cut, "--out", yard_run.folder / "cut.ply"),
        "record": lambda: cli("record", yard_run.output),
        "plant": lambda: cli("plant", yard_run.output, "--count", "1"),
    }[command]()
    assert outcome.code == 1, outcome.err
    assert path.name in outcome.err


def test_files_that_do_not_follow_from_each_other_are_not_evaluated(
    cli: Cli, yard_run: YardRun
) -> None:
    assert ran(go_on(cli, yard_run, "--set", "cluster.min_hits=4", "--until", "cluster"))
    truth = yard_run.folder / "truth.csv"
    truth.write_text("x,y\n-3.1,-2.6\n")
    outcome = cli("eval", yard_run.output, "--truth", truth)
    assert outcome.code == 1
    assert "06_verify.mcap was not made from 05_cluster.mcap" in outcome.err


def test_garbage_in_place_of_a_file_is_replaced(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    for stage in NAMES:
        yard_run.mcap(stage).write_bytes(os.urandom(5000))
    assert ran(go_on(cli, yard_run)) == NAMES
    assert_same_results(yard_run, finished_yard)


def test_left_overs_of_any_content_do_no_harm(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    left = itertools.cycle([b"", b"\x89MCAP0\r\n", b"no mcap at all" * 99])
    for stage in NAMES:
        path = yard_run.mcap(stage)
        for suffix in (".mcap.partial", ".mcap.interrupted"):
            path.with_suffix(suffix).write_bytes(next(left))
    for name in (*RESULTS, "config.resolved.toml", "run.rrd"):
        (yard_run.output / f"{name}.partial").write_bytes(next(left))
    go_on(cli, yard_run, "--from", "ground")
    assert_same_results_of_the_stages_that_ran(yard_run, finished_yard)


def assert_same_results_of_the_stages_that_ran(run: YardRun, reference: YardRun) -> None:
    for stage in NAMES:
        assert content(run.mcap(stage)) == content(reference.mcap(stage)), stage
    assert not [n for n in left_overs(run.output) if n.startswith(("03", "04", "05", "06", ".s"))]


class Killed(BaseException):
    """Stands for the end of the process: nothing may catch it."""


def test_a_scan_goes_on_at_the_tile_where_it_stopped(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    done = 3
    tiles = sum(topic == "/scan/scores" for topic, _ in content(yard_run.mcap("scan")))
    assert tiles > done + 1
    yard_run.mcap("scan").unlink()
    interrupt_at_message(cli, yard_run, "/scan/scores", done)
    outcome = go_on(cli, yard_run)
    assert f"went on from tile {done} of {tiles}" in outcome.out
    assert_same_results(yard_run, finished_yard)


def test_a_scan_that_stops_again_and_again_ends_the_same(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    yard_run.mcap("scan").unlink()
    for message in (2, 4, 1, 6):  # the third time sooner than before: nothing may be lost
        interrupt_at_message(cli, yard_run, "/scan/scores", message)
    outcome = go_on(cli, yard_run)
    assert "went on from tile 6" in outcome.out
    assert_same_results(yard_run, finished_yard)


def test_a_verification_goes_on_at_the_block_where_it_stopped(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    looks = sum(topic == "/verify/hypotheses" for topic, _ in content(yard_run.mcap("verify")))
    assert looks >= 4
    yard_run.mcap("verify").unlink()
    interrupt_at_message(cli, yard_run, "/verify/hypotheses", 1)
    interrupt_at_message(cli, yard_run, "/verify/hypotheses", looks // 2 + 1)
    outcome = go_on(cli, yard_run)
    assert f"went on after {looks // 2} blocks of the first look, 1 of the second" in outcome.out
    assert_same_results(yard_run, finished_yard)


def test_tiles_of_another_setting_are_not_taken_over(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    yard_run.mcap("scan").unlink()
    interrupt_at_message(cli, yard_run, "/scan/scores", 3, "--set", "scan.bin_m=0.25")
    outcome = go_on(cli, yard_run)
    assert "went on" not in outcome.out
    assert_same_results(yard_run, finished_yard)


def interrupt_at_message(
    cli: Cli, run: YardRun, topic_name: str, message: int, *options: str
) -> None:
    """Start a run that dies before it writes message number ``message`` of a topic."""
    write_bytes = StageFileWriter.write_bytes
    written = 0

    def counting(writer: StageFileWriter, topic: Topic[Any], data: bytes) -> None:
        nonlocal written
        if topic.name == topic_name:
            if written == message:
                raise Killed
            written += 1
        write_bytes(writer, topic, data)

    with (
        mock.patch.object(StageFileWriter, "write_bytes", counting),
        mock.patch.object(mcap_file, "CHUNK_BYTES", 1),  # as if each tile filled a chunk
        pytest.raises(Killed),
    ):
        go_on(cli, run, *options)


@settings(max_examples=6)
@given(share=st.floats(0, 1))
def test_a_scan_killed_at_any_byte_ends_the_same(
    cli: Cli, finished_yard: YardRun, tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    run = finished_yard.copy(tmp_path_factory.mktemp("killed"))
    path = run.mcap("scan")
    partial = path.rename(path.with_suffix(".mcap.partial"))
    os.truncate(partial, int(share * partial.stat().st_size))
    assert ran(go_on(cli, run)) == ["scan"]
    assert_same_results(run, finished_yard)


def test_a_kill_between_stage_and_results_is_mended(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    for name in RESULTS:
        (yard_run.output / name).unlink()
    assert ran(go_on(cli, yard_run)) == []
    assert_same_results(yard_run, finished_yard)


def test_a_second_process_in_the_folder_is_refused(cli: Cli, yard_run: YardRun) -> None:
    with (yard_run.output / ".lock").open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        outcome = go_on(cli, yard_run, "--from", "scan")
        assert outcome.code == 1
        assert len(outcome.err.splitlines()) == 1
        assert "another spinpipe works in this folder" in outcome.err
    assert ran(go_on(cli, yard_run)) == []


def test_an_error_of_a_stage_leaves_what_was_complete(
    cli: Cli, finished_yard: YardRun, yard_run: YardRun
) -> None:
    """A stage that fails must not cost the file that an earlier run made."""
    outcome = go_on(
        cli, yard_run, "--set", "ground.sample_points=1000", "--set", "model.saloon.scale=1000"
    )
    assert outcome.code == 1
    assert ran(go_on(cli, yard_run)) == []
    assert_same_results(yard_run, finished_yard)


def test_a_broken_program_says_so_in_one_line(cli: Cli, yard_run: YardRun) -> None:
    with mock.patch.object(Runner, "run", side_effect=RuntimeError("two\nlines")):
        outcome = go_on(cli, yard_run)
    assert outcome.code == 70
    assert outcome.err.count("\n") == 1
    assert "internal error: RuntimeError: two lines" in outcome.err
