"""Fixtures for all tests: a small scene, the command line in this process, runs to start from."""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import hypothesis
import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from spinpipe.pipeline.scenes.artificial_cars import SALOON, car_mesh
from spinpipe.schemas.arrays import F64
from spinpipe.stages import STAGES
from spinpipe.stages.geometry.shapes import (
    box,
    covered_from_above,
    cylinder,
    merged,
    placed,
    sample_surface,
    surface_area,
)
from spinpipe.stages.verify import judge

# Many tests start processes that import the same libraries: compiled once, they start in half the
# time, whatever the environment says.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

hypothesis.settings.register_profile(
    "spinpipe",
    deadline=None,  # machines are busy, kernels compile
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
    print_blob=True,
    max_examples=50,
)
hypothesis.settings.load_profile("spinpipe")


YARD_CONFIG = """\
[ingest]
scene = "scene.ply"

[[model]]
name = "saloon"
path = "saloon.ply"

[scan]
radius_m = 2.5
height_m = 1.0
bin_m = 0.2
"""


@dataclass(frozen=True)
class Outcome:
    """How a command ended, and what it said."""

    code: int
    out: str
    err: str
    """Without the lines of progress: a cold or busy machine has more of them."""


def without_progress(err: str) -> str:
    """Standard error less what tells how far a stage is: ``  scan: ...``."""
    names = "|".join(stage.name for stage in STAGES)
    return re.sub(rf"(?m)^  (?:{names}): .*\n", "", err)


Cli = Callable[..., Outcome]
"""``cli(*arguments, cwd=folder)``: the command line as a user calls it, in this process."""


@dataclass(frozen=True)
class Yard:
    """A small scene: a yard with two saloons, a crate and a pole; and the saloon's own cloud."""

    xyz: F64
    """(N, 3) scene, metres, z up."""
    model: F64
    """(M, 3) object frame."""
    cars: tuple[tuple[float, float, float], ...]
    """x, y, heading in degrees."""

    def write(self, folder: Path, xyz: F64 | None = None, extra: str = "") -> Path:
        """Write scene.ply, saloon.ply and config.toml, and return the config's path."""
        folder.mkdir(parents=True, exist_ok=True)
        write_ply(folder / "scene.ply", self.xyz if xyz is None else xyz)
        write_ply(folder / "saloon.ply", self.model)
        config = folder / "config.toml"
        config.write_text(YARD_CONFIG + extra)
        return config


@dataclass(frozen=True)
class YardRun:
    """A complete run over the yard, to be copied and continued."""

    folder: Path
    """Holds scene, model and config."""

    @property
    def config(self) -> Path:
        return self.folder / "config.toml"

    @property
    def output(self) -> Path:
        return self.folder / "run"

    def mcap(self, stage: str) -> Path:
        """The file of a stage."""
        return next(self.output.glob(f"*_{stage}.mcap"))

    def detections(self) -> list[dict[str, Any]]:
        """Content of detections.json."""
        return read_detections(self.output)

    def copy(self, folder: Path) -> YardRun:
        """The same run in another folder."""
        shutil.copytree(self.folder, folder, dirs_exist_ok=True)
        return YardRun(folder)


def read_detections(output: Path) -> list[dict[str, Any]]:
    """All detections of a run."""
    return json.loads((output / "detections.json").read_text())["detections"]


def write_ply(path: Path, xyz: F64, number: str = "<f8", text: bool = False) -> None:
    """A cloud as PLY, nothing but coordinates."""
    rows = np.empty(len(xyz), [(axis, number) for axis in "xyz"])
    for i, axis in enumerate("xyz"):
        rows[axis] = xyz[:, i]
    PlyData([PlyElement.describe(rows, "vertex")], text=text, byte_order="<").write(str(path))


def make_yard(side_m: float = 13.0, density: float = 110.0, seed: int = 3) -> Yard:
    """Sample the yard with ``density`` points per square metre; no ground below the cars."""
    rng = np.random.default_rng(seed)
    saloon = car_mesh(SALOON)
    cars = ((-3.1, -2.6, 30.0), (3.0, 2.7, 205.0))
    standing = merged([placed(saloon, (x, y, 0.0), heading) for x, y, heading in cars])
    crate = placed(box(1.2, 0.8, 1.0), (4.6, -4.4, 0.0), 20.0)
    pole = placed(cylinder(0.1, 3.0), (-4.8, 4.6, 0.0))
    ground = rng.uniform(-side_m / 2, side_m / 2, (round(side_m**2 * density), 3)) * [1, 1, 0]
    ground = ground[~covered_from_above(ground, standing)]
    upright = [
        sample_surface(*mesh, round(surface_area(mesh) * density), rng)[0]
        for mesh in (standing, crate, pole)
    ]
    xyz = np.concatenate([ground, *upright])
    xyz = xyz + rng.normal(0, 0.005, xyz.shape)
    model, _ = sample_surface(*saloon, 8000, rng)
    return Yard(xyz, model, cars)


def run_command_line(*arguments: str | Path, cwd: Path | None = None) -> Outcome:
    """Call the command's entry point with its own arguments, output and working folder."""
    from spinpipe.pipeline.cli import main

    out, err = io.StringIO(), io.StringIO()
    code: Any = 0
    with (
        mock.patch.object(sys, "argv", ["spinpipe", *map(str, arguments)]),
        contextlib.chdir(cwd or Path.cwd()),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as stop:
            code = stop.code or 0
    return Outcome(int(code), out.getvalue(), without_progress(err.getvalue()))


@pytest.fixture(scope="session")
def cli() -> Cli:
    """The command line in this process: saves the seconds that a new interpreter imports for."""
    return run_command_line


@pytest.fixture(scope="session")
def yard() -> Yard:
    """The small scene."""
    return make_yard()


SharedByWorkers = Callable[[str, Callable[[Path], None]], Path]
"""``shared_by_workers(name, make)``: a folder that the first worker has made, to be copied."""


@pytest.fixture(scope="session")
def shared_by_workers(tmp_path_factory: pytest.TempPathFactory) -> SharedByWorkers:
    """What several workers of a test run would compute alike is computed by one."""
    root = tmp_path_factory.getbasetemp()
    if os.environ.get("PYTEST_XDIST_WORKER"):
        root = root.parent

    def folder_of(name: str, make: Callable[[Path], None]) -> Path:
        folder, done = root / name, root / f"{name}.done"
        with (root / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not done.exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                make(folder)
                done.touch()
        return folder

    return folder_of


@pytest.fixture(scope="session")
def finished_yard(yard: Yard, shared_by_workers: SharedByWorkers) -> YardRun:
    """A complete run over the yard; copy it before changing anything."""

    def make(folder: Path) -> None:
        config = yard.write(folder, extra="\n[run]\nname = 'yard'\n")
        text = config.read_text().replace(
            'scene = "scene.ply"', 'scene = "scene.ply"\ntile_points = 2048'
        )
        config.write_text(text)
        run = ("run", config, "--rerun", "off", "-o", folder / "run")
        with compiled_aside() as compile_rest:
            assert run_command_line(*run, "--until", "cluster").code == 0
            compile_rest()
            outcome = run_command_line(*run)
            assert outcome.code == 0, outcome.err

    return YardRun(shared_by_workers("yard", make))


@contextlib.contextmanager
def compiled_aside() -> Generator[Callable[[], None]]:
    """Half of the kernels are compiled by another process; what is given compiles the rest.

    Cold kernels take a minute; where there are any nothing is done.
    """
    if any(Path(judge.__file__).parent.rglob("*.nbc")):
        yield lambda: None
        return
    from tests import compile_kernels

    command = [sys.executable, compile_kernels.__file__]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:

        def rest() -> None:
            compile_kernels.coarse_search()
            assert process.stdout is not None
            process.stdout.readline()

        yield rest


@pytest.fixture
def yard_run(finished_yard: YardRun, tmp_path: Path) -> YardRun:
    """A complete run over the yard that a test may change."""
    return finished_yard.copy(tmp_path / "yard")


@pytest.fixture(scope="session")
def shared_cases(shared_data: Path) -> Path:
    """Folder of small inputs that fail elsewhere; skips where there is none."""
    return shared_data.parent / "cases"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real data, which is not part of the project; skips where there is none."""
    data = Path(__file__).parents[2] / "shared" / "data"
    if not data.is_dir():
        pytest.skip("the real data is not here")
    return data
