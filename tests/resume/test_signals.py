"""However a process is asked to end, and whoever stops listening: one sentence, nothing lost."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.conftest import Cli, YardRun

COMMAND = "from spinpipe.pipeline.entry import main; main()"
SENTENCE = "spinpipe: interrupted; run it again to go on\n"
HANGS_S = 20  # a second is what it takes on an idle machine


def heed() -> None:
    """A shell that puts the tests in the background lets its children ignore SIGINT."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def start(run: YardRun, *options: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, "run", str(run.config), "-o", str(run.output), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heed,
    )


@pytest.mark.parametrize(
    ("number", "share"),
    [
        *((signal.SIGINT, share) for share in (0.0, 0.5)),
        (signal.SIGTERM, 0.3),
        (signal.SIGHUP, 0.5),
    ],
)
def test_a_signal_ends_the_run_and_leaves_nothing(
    cli: Cli, yard_run: YardRun, number: signal.Signals, share: float
) -> None:
    """While it imports, early and late in a run that draws."""
    process = start(yard_run, "--from", "ingest")
    handlers = f"/proc/{process.pid}/status"
    while not _ready(handlers):  # until then Python itself answers, not we
        time.sleep(0.001)
    time.sleep(share * 4)
    process.send_signal(number)
    _, err = process.communicate(timeout=HANGS_S)
    assert (process.returncode, err) == (128 + number, SENTENCE)
    names = [path.name for path in yard_run.output.iterdir()]
    left = [n for n in names if n.startswith(".scratch") or n.endswith(".partial")]
    assert [n for n in left if not n.endswith(".mcap.partial")] == []  # a stage goes on from it
    assert cli("run", yard_run.config, "--rerun", "off", "-o", yard_run.output).code == 0


def _ready(status: str) -> bool:
    """Whether the last of the handlers stands."""
    with open(status) as file:  # noqa: PTH123
        caught = next(line for line in file if line.startswith("SigCgt"))
    return bool(int(caught.split()[1], 16) >> (signal.SIGHUP - 1) & 1)


@pytest.mark.parametrize("arguments", [("stages",), ("--help",), ("run", "CONFIG")])
def test_a_closed_pipe_is_no_error(yard_run: YardRun, arguments: tuple[str, ...]) -> None:
    given = [str(yard_run.config) if word == "CONFIG" else word for word in arguments]
    process = subprocess.Popen(
        [sys.executable, "-c", COMMAND, *given],
        cwd=yard_run.folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    process.stdout.close()
    _, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")


def test_a_full_disk_behind_standard_output_is_told() -> None:
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = subprocess.run(
            [sys.executable, "-c", COMMAND, "--version"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr.startswith("spinpipe: standard output: No space left on device")
    assert done.stderr.count("\n") == 1
