"""The recording that the tests of drawing look into."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import rerun as rr
from tests.unit.pipeline.drawn import draw, make_run


@pytest.fixture(scope="module")
def strict() -> Iterator[None]:
    """Misuse of the SDK is an error instead of a warning."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def recording(strict: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a small run."""
    return draw(tmp_path_factory.mktemp("recording") / "run.rrd", make_run())
