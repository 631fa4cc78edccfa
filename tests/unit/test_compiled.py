"""Numba looks only at the file of the outermost kernel; the rest is in what it encloses."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba import typeof
from numba.core.dispatcher import Dispatcher

from spinpipe.schemas.records import Sampling
from spinpipe.stages import compiled
from spinpipe.stages.geometry.shapes import box, sample_surface
from spinpipe.stages.geometry.support import find_surfaces
from spinpipe.stages.scan import kernel as scan_kernels
from spinpipe.stages.scan.correlate import build_index
from spinpipe.stages.verify.judge import kernels as judge_kernels
from spinpipe.stages.verify.model.field import build_model_field
from spinpipe.stages.verify.scene.cell_grid import grid_of

FOLDER = Path(compiled.__file__).parent
CACHED = {"scan": scan_kernels, "verify": judge_kernels}


def _named(function):
    """What a compiled function takes from its module and from what it encloses."""
    code = inspect.unwrap(function).__code__
    enclosed = zip(code.co_freevars, function.__closure__ or (), strict=True)
    named = dict(function.__globals__) | {name: cell.cell_contents for name, cell in enclosed}
    return [named[name] for name in (*code.co_names, *code.co_freevars) if name in named]


def _files(kernel, seen):
    """Files of a kernel, of the kernels that it calls and of the types it makes."""
    for item in [kernel, *_named(kernel.py_func)]:
        if isinstance(item, Dispatcher) and item not in seen:
            seen[item] = Path(item.py_func.__code__.co_filename)
            _files(item, seen)
        elif inspect.isclass(item):
            seen[item] = Path(inspect.getfile(item))
    return set(seen.values())


@pytest.mark.parametrize("folder", CACHED)
def test_cached_kernels_are_keyed_by_all_their_sources(folder):
    key = compiled.sources(folder)[:16]
    cached = [
        item
        for item in vars(CACHED[folder]).values()
        if isinstance(item, Dispatcher) and item.py_func.__qualname__.endswith(key)
    ]
    assert len(cached) >= 2
    for kernel in cached:
        for file in _files(kernel, {}):
            assert file == Path(compiled.__file__) or file.is_relative_to(FOLDER / folder)
            assert "stages.compiled import" in file.read_text() or file.stem == "compiled"


YARD = """
from typing import NamedTuple
from spinpipe.stages import compiled
compiled.__file__ = {here!r}

class {name}(NamedTuple):
    size: float

@compiled.kept("yard")
def area(of):
    return of.size * of.size

print(area({name}(3.0)))
"""


def test_kernels_kept_by_an_earlier_version_stop_none(tmp_path):
    """Of a type that is gone: numba reads the signatures of all that it finds under a name."""
    script = tmp_path / "yard" / "kernels.py"
    script.parent.mkdir()
    for name in ("Square", "Square", "Quad"):
        text = YARD.format(here=str(tmp_path / "compiled.py"), name=name)
        script.write_text(f"# stages.compiled import{text}")
        (tmp_path / "compiled.py").touch()
        done = subprocess.run(
            [sys.executable, "-c", "import kernels"],
            cwd=script.parent, env={**os.environ, "PYTHONPATH": str(script.parent)},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.stdout == "9.0\n", done.stderr
    assert len({kept.name.split("-")[0] for kept in script.parent.rglob("*.nbi")}) == 2


def test_a_change_to_any_kernel_changes_the_key_and_other_changes_do_not(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    kernel = "from spinpipe.stages.compiled import inner\n"
    texts = {"compiled": "", "scan/a": kernel, "scan/deep/b": kernel, "scan/plain": "x = 1\n"}
    for name, text in texts.items():
        (tmp_path / f"{name}.py").parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / f"{name}.py").write_text(text)
    keys = {compiled.sources("scan")}
    for name, text in texts.items():
        (tmp_path / f"{name}.py").write_text(f"{text}# changed")
        keys.add(compiled.sources("scan"))
    assert len(keys) == len(texts)


@pytest.mark.parametrize("folder", CACHED)
def test_constants_of_kernels_come_from_their_sources(folder):
    """What a kernel takes from a file without kernels would change unseen."""
    for file in (FOLDER / folder).rglob("*.py"):
        text = file.read_text()
        if "stages.compiled import" not in text:
            continue
        for line in text.splitlines():
            if line.startswith("from spinpipe.stages."):
                named = FOLDER.joinpath(*line.split()[1].split(".")[2:]).with_suffix(".py")
                known = "stages.compiled import" in named.read_text() or named.stem == "compiled"
                hosts = (
                    ("model", "field.py"),
                    ("geometry", "columns.py"),
                )  # only arrays come from them
                assert known or named.parts[-2:] in hosts, f"{file}: {line}"


def test_kernels_get_arrays_of_one_kind_whatever_is_looked_at():
    """For each kind, and each layout, they would be compiled once more: minutes at a first run."""
    rng = np.random.default_rng(0)
    points, normals = sample_surface(*box(1.2, 0.8, 1.0), 500, rng)
    field = build_model_field("crate", points, normals, resolution=8)
    assert typeof(field.glanced(3)) == typeof(field)
    clouds = [points, points[:1], np.tile(points[:1], (9, 1)), points * [1, 1, 0]]
    surfaces = [find_surfaces(xyz, Sampling(0.1, 0.0), 1.0, 0.5) for xyz in clouds]
    assert len({typeof(found) for found in surfaces}) == 1
    grids = [grid_of(xyz, Sampling(0.1, 0.0)) for xyz in clouds]
    assert len({typeof(grid) for grid in grids}) == 1
    assert len({typeof(build_index(xyz.astype(np.float32))) for xyz in clouds}) == 1
