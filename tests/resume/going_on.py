"""A run gone on with: what it did, and that it ended the same."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mcap.reader import make_reader

from spinpipe.stages import STAGES

if TYPE_CHECKING:
    from tests.conftest import Cli, Outcome, YardRun


NAMES = [stage.name for stage in STAGES]


RESULTS = ("detections.json", "detections.csv", "detections.ply")


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
