"""Mutation testing: does a test fail when the code decides, keys or stores otherwise?

    uv run python tests/fuzz/mutants.py sides decide keys files store [--most 100]

One operator, number, condition or call at a time is changed, in memory and in a fork of a process
in which the tests have run once; what the tests of the verification search for is kept from there.
A mutant that no test notices is printed: it is equal to the code, or a test is missing.
"""

from __future__ import annotations

import argparse
import ast
import copy
import importlib
import os
import random
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from spinpipe.stages.verify.judge.search import Search

ROOT = Path(__file__).parents[2]
LIMIT_S = 60.0
"""Processor time of the tests of one mutant; one that takes longer is noticed."""
TARGETS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "sides": (("stages.verify.decide.continuation",), ("tests/unit/verify/test_continuation.py",)),
    "decide": (
        tuple(f"stages.verify.decide.{name}" for name in ("decision", "group", "neighbours")),
        ("tests/unit/verify/test_recognition.py",),
    ),
    "keys": (
        ("pipeline.keys", "pipeline.plan", "pipeline.input_files"),
        ("tests/unit/pipeline/test_keys_and_plan.py", "tests/resume/test_inputs.py"),
    ),
    "files": (("pipeline.mcap_file",), ("tests/unit/pipeline/test_mcap_file.py",)),
    "store": (("pipeline.atomic", "pipeline.outputs"), ("tests/resume/test_outputs.py",)),
}
"""Modules to be changed, and the tests that know them."""
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.And: ast.Or, ast.Or: ast.And, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip


def mutants(tree: ast.Module) -> Iterator[tuple[str, ast.Module]]:
    """Every change of a module, with a line that says what it is."""
    for node in ast.walk(tree):
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list"):
                continue
            values: list[Any] = value if isinstance(value, list) else [value]
            for k, old in enumerate(values):
                new = _other(old, field)
                if new is None:
                    continue
                line = getattr(old, "lineno", getattr(node, "lineno", 0))
                before = ast.unparse(node).splitlines()[0]
                changed = [*values[:k], new, *values[k + 1 :]]
                setattr(node, field, changed if isinstance(value, list) else new)
                after = ast.unparse(node).splitlines()[0]
                what = f"{line}: {before}" + (f"  ->  {after}" if after != before else "")
                yield what, copy.deepcopy(tree)
                setattr(node, field, value)


def _other(node: object, field: str) -> ast.AST | None:
    """What stands there instead, or None where nothing is changed."""
    if type(node) in SWAPS:
        return SWAPS[type(node)]()
    match node:
        case ast.Constant(value=bool(value)):
            return ast.Constant(not value)
        case ast.Constant(value=int(value)):
            return ast.Constant(value + 1)
        case ast.Constant(value=float(value)):
            return ast.Constant(1.5 * value + 0.1)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return operand
        case ast.Expr(value=ast.Call()) | ast.Raise() | ast.AugAssign():
            return ast.Pass()
        case ast.expr() if field == "test":
            return ast.UnaryOp(ast.Not(), node)
        case _:
            return None


def put_in(module: ModuleType, tree: ast.Module) -> None:
    """Execute a changed module in place of the old, whoever has imported its names."""
    old = {id(value): name for name, value in vars(module).items() if not name.startswith("__")}
    own = {
        key for key, name in old.items()
        if getattr(vars(module)[name], "__module__", "") == module.__name__
    }  # fmt: skip
    exec(compile(ast.fix_missing_locations(tree), str(module.__file__), "exec"), vars(module))
    for other in list(sys.modules.values()):
        if other is not module and getattr(other, "__name__", "").startswith(("spinpipe", "tests")):
            for name, value in list(vars(other).items()):
                if id(value) in own:
                    setattr(other, name, vars(module)[old[id(value)]])


def tested(tests: tuple[str, ...], folder: Path) -> int:
    """Exit code of the tests; the finished run that they share is beside their folder."""
    options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", f"--basetemp={folder}/tests"]
    return int(pytest.main([*options, *(str(ROOT / test) for test in tests)]))


def noticed(module: ModuleType, tree: ast.Module, tests: tuple[str, ...], folder: Path) -> bool:
    """Whether a test fails with the changed module."""
    child = os.fork()
    if not child:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        code = 1
        try:
            signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
            put_in(module, tree)
            code = tested(tests, folder)
        finally:
            os._exit(code)
    return os.waitpid(child, 0)[1] != 0


def _keep_searches() -> None:
    """What is searched for is the same for each mutant of the decision."""
    run, kept, calls = Search.run, dict[tuple[str, int], Any](), list[str]()

    def again(self: Search, *arguments: Any) -> Any:
        test = os.environ["PYTEST_CURRENT_TEST"]
        if test not in calls:
            calls.clear()
        calls.append(test)
        if (test, len(calls)) not in kept:
            kept[test, len(calls)] = run(self, *arguments)
        return kept[test, len(calls)]

    setattr(Search, "run", again)  # noqa: B010  # passes on whatever it is given


def main() -> None:
    """Change the modules asked for and print what no test notices."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("targets", nargs="+", choices=TARGETS)
    parser.add_argument("--most", type=int, default=1_000_000, help="of each target, drawn")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    os.environ["PYTEST_XDIST_WORKER"] = "one"  # so that runs are shared through the folder
    _keep_searches()
    for target in given.targets:
        names, tests = TARGETS[target]
        modules = [importlib.import_module(f"spinpipe.{name}") for name in names]
        folder = Path(tempfile.mkdtemp())
        if tested(tests, folder):
            sys.exit("tests fail without any change")
        every = [
            (module, *mutant)
            for module in modules
            for mutant in mutants(ast.parse(Path(str(module.__file__)).read_text()))
        ]
        drawn = random.Random(given.seed).sample(every, min(given.most, len(every)))
        survivors = 0
        for module, what, tree in sorted(drawn, key=lambda each: str(each[0].__file__)):
            if not noticed(module, tree, tests, folder):
                survivors += 1
                print(f"    {Path(str(module.__file__)).name}:{what}", flush=True)
        print(f"| {target} | {len(drawn)} of {len(every)} | {survivors} survive |", flush=True)
        shutil.rmtree(folder)


if __name__ == "__main__":
    main()
