"""What every refusal must look like, and leave."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tests.conftest import Outcome

if TYPE_CHECKING:
    pass


def assert_one_line(outcome: Outcome, code: int, *said: str) -> None:
    assert outcome.code == code, outcome
    assert outcome.err.count("\n") == 1, outcome.err
    assert outcome.err.startswith("spinpipe: ")
    assert "Traceback" not in outcome.err
    assert "internal error" not in outcome.err
    for text in said:
        assert text in outcome.err


def assert_nothing_half_written(folder: Path, complete: str = "") -> None:
    for path in folder.rglob("*"):
        assert path.suffix not in (".partial", ".interrupted", ".mcap") or path.name == complete
        assert not path.name.startswith(("detections", ".scratch")), path
