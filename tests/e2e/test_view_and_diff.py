"""``view`` serves the recording of a run, ``diff`` draws what two runs do not share."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import urlopen

import pytest
from rerun.chunk import RrdReader
from tests.conftest import Cli, YardRun

from spinpipe.pipeline.drawing.recording import find_viewer
from spinpipe.pipeline.results.view import WEB_PORT


def test_view_says_what_is_missing(
    cli: Cli, yard_run: YardRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = cli("view", yard_run.output)
    assert outcome.code == 1
    assert "no recording yet; spinpipe record" in outcome.err
    assert cli("record", yard_run.output).code == 0
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    outcome = cli("view", yard_run.output)
    assert outcome.code == 1
    assert "no display to open a viewer on: use --web" in outcome.err
    outcome = cli("view", yard_run.output, "--candidate", "4000")
    assert outcome.code == 1
    assert "no candidate 4000: ids go from 0 to" in outcome.err


def test_view_serves_the_recording_to_a_browser(cli: Cli, yard_run: YardRun) -> None:
    """Also while somebody else holds Rerun's own ports."""
    assert cli("record", yard_run.output).code == 0
    with socket.socket() as taken:
        try:
            taken.bind(("", WEB_PORT))
            taken.listen()
        except OSError:
            pass  # by somebody else indeed
        process = subprocess.Popen(
            [Path(sys.executable).with_name("spinpipe"), "view", yard_run.output, "--web"],
            env={**os.environ, "BROWSER": "true"},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            text=True,
        )
        assert process.stdout is not None
        said = process.stdout.readline()
    try:
        (address,) = re.findall(r"http://[\d.:]+", said)
        assert not address.endswith(f":{WEB_PORT}")
        page, deadline = b"", time.monotonic() + 60
        while not page and time.monotonic() < deadline and process.poll() is None:
            try:
                page = urlopen(address, timeout=5).read()
            except OSError:
                time.sleep(0.3)
        assert b"<title>Rerun" in page
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def test_diff_draws_what_only_one_run_has(cli: Cli, yard_run: YardRun, tmp_path: Path) -> None:
    strict = yard_run.copy(tmp_path / "strict")
    setting = "verify.evidence.min_score=0.9999"
    outcome = cli("run", strict.config, "-o", strict.output, "--set", setting, "--rerun", "off")
    assert outcome.code == 0, outcome.err
    accepted = [d["id"] for d in yard_run.detections() if d["fate"] == "accepted"]
    assert not [d for d in strict.detections() if d["fate"] == "accepted"]
    recording = tmp_path / "both.rrd"
    outcome = cli("diff", yard_run.output, strict.output, "--record", recording)
    assert outcome.code == 0, outcome.err
    assert f"0 gained, {len(accepted)} lost, 0 moved" in outcome.out
    viewer = find_viewer()
    assert viewer is not None
    subprocess.run([viewer, "rrd", "verify", str(recording)], check=True, capture_output=True)
    labels: dict[str, list[str]] = {}
    for chunk in RrdReader(recording).store().stream().filter(content="/**"):
        batch = chunk.to_record_batch()
        if "Boxes3D:labels" in batch.schema.names:
            labels[chunk.entity_path] = batch.column("Boxes3D:labels").to_pylist()[0] or []
    assert sorted(int(text.split()[0]) for text in labels["/before/lost"]) == sorted(accepted)
    assert not labels.get("/after/gained")
    assert cli("diff", yard_run.output, strict.output, "--record", recording).code == 1
