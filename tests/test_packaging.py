"""The wheel: complete, and enough to run the command in an empty environment."""

from __future__ import annotations

import os
import shutil
import subprocess
import zipfile
from email.parser import Parser
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.conftest import YardRun

ROOT = Path(__file__).parents[1]
UV = shutil.which("uv")

pytestmark = [
    pytest.mark.packaging,
    pytest.mark.skipif(UV is None, reason="uv builds and installs the wheel"),
]


def uv(*arguments: str | Path, cwd: Path | None = None) -> str:
    """Run uv; its output is the error message if it fails."""
    command = ["uv", *map(str, arguments)]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built from the files that git knows, not from left-overs of this checkout."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    for name in listed.stdout.splitlines():
        path = ROOT / name
        if path.is_file() and not path.is_symlink():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, source / name)
    uv("build", "--wheel", "--out-dir", target, source)
    return next(target.glob("*.whl"))


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty environment with the wheel and what it asks for."""
    folder = tmp_path_factory.mktemp("environment")
    uv("venv", "--no-project", folder)
    uv("pip", "install", "--python", folder / "bin" / "python", wheel)
    (packages,) = folder.glob("lib/*/site-packages/spinpipe")
    lend_kernels(packages)
    return folder


def lend_kernels(packages: Path) -> None:
    """Kernels that were compiled from the same sources here serve there; compiling takes a minute.

    Numba takes a kernel for its source's if that has the same size and time.
    """
    for kernel in (ROOT / "stages").rglob("*.nb[ic]"):
        target = packages / kernel.relative_to(ROOT)
        target.parent.mkdir(exist_ok=True)
        shutil.copy(kernel, target)
    for source in (ROOT / "stages").rglob("*.py"):
        target = packages / source.relative_to(ROOT)
        assert target.read_bytes() == source.read_bytes()
        target.unlink()  # a link to what uv keeps
        shutil.copy2(source, target)


def test_every_module_is_in_the_wheel_and_nothing_else(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    for folder in ("schemas", "stages", "pipeline"):
        here = {str(path.relative_to(ROOT)) for path in (ROOT / folder).rglob("*.py*")}
        here = {name for name in here if "__pycache__" not in name}
        assert {f"spinpipe/{name}" for name in here} <= set(names)
        assert f"spinpipe/{folder}/py.typed" in names
    others = {"schemas/spinpipe.proto", "pipeline/results/report.html", "recordings/carpark.toml"}
    assert {f"spinpipe/{name}" for name in others} <= set(names)
    assert all(name.startswith(("spinpipe/", "spinpipe-")) for name in names)


def test_licence_and_metadata_are_there(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    info = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
    metadata = Parser().parsestr(archive.read(info).decode())
    assert metadata["Name"] == "spinpipe"
    assert metadata["License-Expression"] == "MIT"
    licence = next(n for n in archive.namelist() if n.endswith("/licenses/LICENSE"))
    assert b"MIT License" in archive.read(licence)
    assert "spinpipe" in str(metadata.get_payload()), "the README is the description"


def test_the_command_runs_from_an_empty_environment(environment: Path, yard_run: YardRun) -> None:
    done = subprocess.run(
        [environment / "bin" / "spinpipe", "run", "config.toml", "--rerun", "off"],
        cwd=yard_run.folder,
        env={k: v for k, v in os.environ.items() if not k.startswith("PYTHON")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "accepted: 2 saloon" in done.stdout
