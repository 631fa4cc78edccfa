"""Numba looks only at the file of the outermost kernel; the rest is in what it encloses."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

from spinpipe.stages import compiled, hypothesis_kernels, spin_scan

FOLDER = Path(compiled.__file__).parent


def _named(function):
    """What a compiled function takes from its module and from what it encloses."""
    code = inspect.unwrap(function).__code__
    enclosed = zip(code.co_freevars, function.__closure__ or (), strict=True)
    named = dict(function.__globals__) | {name: cell.cell_contents for name, cell in enclosed}
    return [named[name] for name in (*code.co_names, *code.co_freevars) if name in named]


def _modules(kernel, seen):
    """Stems of the files of a kernel, of the kernels that it calls and of the types it makes."""
    for item in [kernel, *_named(kernel.py_func)]:
        if isinstance(item, Dispatcher) and item not in seen:
            seen[item] = Path(item.py_func.__code__.co_filename).stem
            _modules(item, seen)
        elif inspect.isclass(item):
            seen[item] = item.__module__.rpartition(".")[2]
    return set(seen.values())


@pytest.mark.parametrize("module", [spin_scan, hypothesis_kernels], ids=lambda m: m.__name__)
def test_cached_kernels_are_keyed_by_all_their_sources(module):
    cached = [
        item
        for item in vars(module).values()
        if isinstance(item, Dispatcher) and item.py_func.__closure__
    ]
    assert len(cached) >= 2
    for kernel in cached:
        enclosed = [cell.cell_contents for cell in kernel.py_func.__closure__]
        assert compiled.sources(*module.SOURCES) in enclosed
        assert _modules(kernel, {}) <= {*module.SOURCES, "compiled"}


def test_a_change_to_any_source_changes_the_key(tmp_path, monkeypatch):
    for name in ("a", "b", "compiled"):
        (tmp_path / f"{name}.py").write_text(name)
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "compiled.py"))
    keys = {compiled.sources("a", "b")}
    for name in ("a", "b", "compiled"):
        (tmp_path / f"{name}.py").write_text(f"{name} changed")
        keys.add(compiled.sources("a", "b"))
    assert len(keys) == 4


@pytest.mark.parametrize("module", [spin_scan, hypothesis_kernels], ids=lambda m: m.__name__)
def test_constants_of_kernels_come_from_their_sources(module):
    """What a kernel takes from elsewhere in spinpipe would change unseen."""
    for name in module.SOURCES:
        text = (FOLDER / f"{name}.py").read_text()
        used = {
            line.split()[1].rpartition(".")[2]
            for line in text.splitlines()
            if line.startswith("from spinpipe.")
        }
        assert used <= {*module.SOURCES, "compiled", "model_field"}
