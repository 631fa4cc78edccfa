"""What the command line loads before it does anything: heavy packages wait until they are used."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = {"rerun", "pycolmap", "trimesh", "laspy", "kiss_icp", "distributed", "matplotlib"}


@pytest.mark.parametrize(
    ("module", "too_heavy"),
    [
        ("spinpipe.pipeline.cli", HEAVY | {"numpy", "pydantic", "rich"}),
        ("spinpipe.pipeline.commands", HEAVY | {"scipy.stats"}),
    ],
)
def test_heavy_packages_wait(module: str, too_heavy: set[str]) -> None:
    code = f"import sys, {module}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout
    assert not too_heavy & set(loaded.decode().split())
