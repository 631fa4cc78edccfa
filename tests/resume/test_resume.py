"""A run goes on from where it stopped, notices every damage, and always ends the same."""

from __future__ import annotations

import fcntl
import itertools
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from spinpipe.pipeline import commands, mcap_file
from spinpipe.pipeline.config import ExecutionSection, load_config
from spinpipe.pipeline.engine import Engine, open_engine
from spinpipe.pipeline.mcap_file import StageFileWriter, check
from spinpipe.pipeline.plan import make_plan
from spinpipe.pipeline.run_folder import RunFolder
from spinpipe.pipeline.runner import Runner
from spinpipe.schemas.topics import Topic
from spinpipe.stages import STAGES

if TYPE_CHECKING:
    from tests.conftest import Cli, Outcome, YardRun

NAMES = [stage.name for stage in STAGES]
RESULTS = ("detections.json", "detections.csv", "detections.ply")

on_a_copy = settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])


def go_on(cli: Cli, run: YardRun, *options: str) -> Outcome:
    outcome: Outcome = cli("run", run.config, "--rerun", "off", "-o", run.output, *options)
    return outcome


def actions(outcome: Outcome) -> dict[str, str]:
    """What the run said that it did, by stage."""
    assert outcome.code == 0, outcome.err
    lines = (line.split() for line in outcome.out.splitlines())
    return {words[1]: words[0] for words in lines if words and words[0] in ("run", "reuse")}


def ran(outcome: Outcome) -> list[str]:
    return [stage for stage, action in actions(outcome).items() if action == "run"]


def content(path: Path) -> list[tuple[str, bytes]]:
    """All messages of a file: everything but what tells when it was written."""
    with path.open("rb") as stream:
        return [
            (channel.topic, message.data)
            for _, channel, message in make_reader(stream).iter_messages()
        ]


def assert_same_results(run: YardRun, reference: YardRun) -> None:
    for name in RESULTS:
        assert (run.output / name).read_bytes() == (reference.output / name).read_bytes(), name
    for stage in NAMES:
        assert content(run.mcap(stage)) == content(reference.mcap(stage)), stage
    assert left_overs(run.output) == []


def left_overs(folder: Path) -> list[str]:
    patterns = ("*.partial", "*.interrupted", ".scratch-*")
    return [path.name for pattern in patterns for path in folder.glob(pattern)]


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


@settings(max_examples=12)
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


# From here on with processes of their own, that really die.


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
    for number, name in enumerate(sorted(p.name for p in finished_yard.output.glob("*.mcap"))):
        process = start(yard_run)
        wait_for(yard_run, f"{name}.partial", process)
        time.sleep(rng.uniform(0, 0.3))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        there = {path.name for path in yard_run.output.glob("*.mcap")}
        assert finished <= there, f"kill {number} lost a finished stage"
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
