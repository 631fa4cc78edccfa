"""The fuzzers themselves work: a few executions of readers that are written here."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

READERS = Path(__file__).with_name("readers.py")
FORMATS = ("ply", "colmap-points", "pcd", "text", "toml", "mcap", "labels")


def test_readers_read_or_refuse_damaged_files() -> None:
    command = [sys.executable, str(READERS), "--executions", "10", "--formats", *FORMATS]
    done = subprocess.run(command, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stdout
    assert len(done.stdout.splitlines()) == len(FORMATS)
