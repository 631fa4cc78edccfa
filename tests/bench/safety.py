"""What one run spends on being safe: processor time in hashes, checks and guarded readers.

    uv run python tests/bench/safety.py CONFIG [MORE OPTIONS OF run]

"hashes" are those of inputs, before and after they are read, and of results; "checks" read every
stage's file back against its checksums, "checksums" are those written into it; "disk" is the clock
while files are flushed; "guard" runs what reads files of others twice, in a child and without one.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from spinpipe.pipeline import cli, commands, keys, mcap_file, outputs, plan, runner
from spinpipe.pipeline.config import load_config
from spinpipe.stages.ingest.readers import e57, las, mcap, mesh
from spinpipe.stages.ingest.readers.open_scene import open_scene

assert commands  # imports what it calls before anything is measured
SPENT: Counter[str] = Counter()
WRAPPED = (
    (keys, "hash_path", "hashes", time.thread_time),
    (plan, "input_identities", "hashes", time.thread_time),
    (runner, "input_identities", "hashes", time.thread_time),
    (outputs, "digest", "hashes", time.thread_time),
    (mcap_file, "check", "checks", time.thread_time),
    (zlib, "crc32", "checksums", time.thread_time),
    (os, "fsync", "disk", time.monotonic),
)


def timed(function: Callable[..., Any], what: str, clock: Callable[[], float]) -> Any:
    """The same function, its time added to ``what``; what is called within counts there alone."""

    def call(*arguments: Any, **named: Any) -> Any:
        before, began = SPENT.total(), clock()
        try:
            return function(*arguments, **named)
        finally:
            SPENT[what] += clock() - began - (SPENT.total() - before)

    return call


@contextmanager
def unguarded() -> Generator[None]:
    """Readers of others without a process of their own."""
    kept = [(reader, vars(reader)["guarded"]) for reader in (e57, las, mcap, mesh)]
    for reader, _ in kept:
        vars(reader)["guarded"] = lambda function, path, *more: function(path, *more)
    yield
    for reader, guarded in kept:
        vars(reader)["guarded"] = guarded


def seconds_to_read(scene: Path) -> float:
    """Processor time of reading a whole scene, of this process and its children; the best of 3."""
    times: list[float] = []
    for _ in range(3):
        began = _used_s()
        for _ in open_scene(scene).chunks(1 << 18):
            pass
        times.append(_used_s() - began)
    return min(times)


def _used_s() -> float:
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def run(config: str, options: list[str]) -> float:
    """Run into a new folder; processor time in all, seconds."""
    with tempfile.TemporaryDirectory() as folder:
        sys.argv = ["spinpipe", "run", config, "-o", str(Path(folder) / "run"), *options]
        began = _used_s()
        try:
            cli.main()
        except SystemExit as stop:
            if stop.code:
                raise
        return _used_s() - began


def main() -> None:
    """Run once to warm up and once to measure; print what each part takes."""
    config, *options = sys.argv[1:]
    run(config, options)
    for module, name, what, clock in WRAPPED:
        setattr(module, name, timed(getattr(module, name), what, clock))
    SPENT.clear()
    whole_s = run(config, options)
    parts = dict(SPENT)
    scene = vars(load_config(Path(config)).stages["ingest"])["scene"]
    with unguarded():
        alone_s = seconds_to_read(scene)
    parts["guard"] = seconds_to_read(scene) - alone_s
    print(f"{whole_s:.2f} s of processor time, of which")
    for what, seconds in parts.items():
        share = "by the clock" if what == "disk" else f"{100 * seconds / whole_s:.1f} %"
        print(f"  {what:<9} {seconds:7.3f} s  {share}")


if __name__ == "__main__":
    main()
