"""Mutation fuzzers of every reader: damaged files must be read or refused in a sentence.

    uv run python tests/fuzz/readers.py [--executions 10000] [--formats laz glb]

Each format runs in a process of its own, which is watched: an exception that is no sentence, a
process that dies, ten seconds of work on one file, and more memory than 4 times the file and 300 MB
are failures; their files are kept.

Files are first read in one fork for many, with the readers of others in it and not in a fork for
each, which takes ten times as long. What ends that fork, or is not read well there, is read again
as users read it, and only that counts.
"""

from __future__ import annotations

import argparse
import mmap
import os
import random
import resource
import selectors
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from spinpipe.pipeline.errors import INTERNAL_ERROR, describe
from spinpipe.stages.ingest.readers import e57, las, mcap, mesh

LIMIT_S = 10.0
WAIT_S = 120.0
"""As long without work: on a busy machine a reader may not get its turn for long."""
MEMORY_FACTOR, MEMORY_BYTES = 4, 300_000_000
NUMBERS = [b"nan", b"-1", b"1e999", b"99999999999999999999", b"0", b"", b"-0", b"1e-320", b"x"]
EDGES = [0, 1, -1, 2**31 - 1, -(2**31), 2**32 - 1, 2**63 - 1, 2**16, 255]


def mutate(data: bytes, rng: random.Random) -> bytes:
    """A file with one to four damages, most of them near its beginning, where headers are."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not out:
            break
        reach = min(len(out), rng.choice((64, 400, len(out))))
        at = rng.randrange(reach)
        match rng.randrange(8):
            case 0:
                out[at] ^= 1 << rng.randrange(8)
            case 1:
                out[at] = rng.choice((0, 255, 127, 10, 32, rng.randrange(256)))
            case 2:
                del out[at : at + rng.choice((1, 2, 8, 100))]
            case 3:
                out[at:at] = bytes(rng.randrange(256) for _ in range(rng.choice((1, 4, 50))))
            case 4:
                del out[rng.randrange(len(out)) :]
            case 5:
                out[at:at] = out[at : at + rng.choice((4, 40, 400))]
            case 6:
                kind = rng.choice("iIqQhH")
                size = struct.calcsize(kind)
                value = rng.choice(EDGES) & ((1 << 8 * size) - 1)
                out[at : at + size] = value.to_bytes(size, "little")
            case _:
                end = at + 1
                while end < len(out) and chr(out[end]) in "0123456789.-e":
                    end += 1
                out[at:end] = rng.choice(NUMBERS)
    return bytes(out)


def work(name: str, first: int, count: int, seed: int, folder: Path) -> None:
    """Read damaged files one by one; a line before each, so that the parent knows which."""
    from seeds import FORMATS

    file_name, write, read = FORMATS[name]
    path = folder / file_name
    write(path)
    whole = path.read_bytes()
    read(path)  # what is imported for the format counts for nobody

    def wrong(number: int) -> str:
        data = mutate(whole, random.Random(f"{seed} {name} {number}"))
        path.write_bytes(data)
        print(number, flush=True)
        return _wrong(read, path)

    while first < count:
        first = _first_unread(wrong, range(first, count))
        if first < count and (what := wrong(first)):
            print("FAIL", what, flush=True)
        first += 1


def _wrong(read: Callable[[Path], object], path: Path) -> str:
    """What is wrong with how a file was read or refused, if anything."""
    size = path.stat().st_size
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew [man 5 proc]
    before = _peak()
    try:
        read(path)
    except Exception as error:
        text, code = describe(error)
        if code == INTERNAL_ERROR or "\n" in text:
            return text.replace("\n", " ")[:300]
    grown = _peak() - before
    most = MEMORY_FACTOR * size + MEMORY_BYTES
    return f"took {grown / 1e6:.0f} MB" if grown > most else ""


def _peak() -> int:
    """Most resident memory of this process so far, bytes."""
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.partition("VmHWM:")[2].split(None, 1)[0])


def _first_unread(wrong: Callable[[int], str], numbers: range) -> int:
    """Number of the first file that a fork without guards did not read or refuse as it should."""
    last = mmap.mmap(-1, 8)  # shared with the fork
    child = os.fork()
    if not child:
        try:
            for reader in (e57, las, mcap, mesh):
                vars(reader)["guarded"] = lambda function, path, *more: function(path, *more)
            limit = _peak() + MEMORY_BYTES + MEMORY_FACTOR * 10_000
            resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            for number in numbers:
                last[:] = number.to_bytes(8, "little")
                signal.setitimer(signal.ITIMER_PROF, LIMIT_S / 4)
                if wrong(number):
                    os._exit(0)
            last[:] = numbers.stop.to_bytes(8, "little")
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    return int.from_bytes(last[:], "little")


def fuzz(name: str, executions: int, seed: int, keep: Path) -> list[str]:
    """Failures of one format, one line each."""
    failures: list[str] = []
    first = 0
    while first < executions:
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, __file__, "--worker", name, str(first), str(executions)]
            process = subprocess.Popen(
                [*command, str(seed), folder], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
            )
            first, ended = _watch(process, first, failures, name)
            if ended and first < executions:
                failures.append(f"{name} {first}: {ended}")
                for file in Path(folder).iterdir():
                    (keep / f"{name}-{seed}-{first}-{file.name}").write_bytes(file.read_bytes())
            first += 1
    return failures


def _watch(
    process: subprocess.Popen[bytes], number: int, failures: list[str], name: str
) -> tuple[int, str]:
    """Number of the last file, and how the process ended if not well."""
    assert process.stdout
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        limit_s = WAIT_S  # for what is imported
        began, worked_s = time.monotonic(), 0.0
        while True:
            if not selector.select(1.0):
                worked = _worked_s(process.pid) - worked_s
                if worked > limit_s or time.monotonic() - began > WAIT_S:
                    process.kill()
                    process.wait()
                    return number, f"hangs, {worked:.0f} s of work"
                continue
            line = process.stdout.readline().decode(errors="replace").strip()
            limit_s, began, worked_s = LIMIT_S, time.monotonic(), _worked_s(process.pid)
            if not line:
                code = process.wait()
                return (number, f"the process died, code {code}") if code else (sys.maxsize - 1, "")
            if line.startswith("FAIL"):
                failures.append(f"{name} {number}: {line[5:]}")
            else:
                number = int(line)


def _worked_s(pid: int) -> float:
    """Processor time of a process and of its children, seconds."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        stats = [Path(f"/proc/{number}/stat").read_text() for number in (pid, *children)]
    except OSError:  # one has just ended
        return 0.0
    fields = [stat.rpartition(")")[2].split() for stat in stats]
    ticks = sum(int(field[11]) + int(field[12]) for field in fields)
    return ticks / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Fuzz and say how it went; exit code 1 if anything failed."""
    from seeds import FORMATS

    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--executions", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--formats", nargs="*", default=list(FORMATS))
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()))
    given = parser.parse_args()
    failed = 0
    for name in given.formats:
        began = time.monotonic()
        failures = fuzz(name, given.executions, given.seed, given.keep)
        failed += len(failures)
        took = time.monotonic() - began
        print(f"| {name} | {given.executions} | {len(failures)} | {took:.0f} s |", flush=True)
        for line in failures[:10]:
            print(f"    {line}")
    sys.exit(failed > 0)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        work(sys.argv[2], *map(int, sys.argv[3:6]), Path(sys.argv[6]))
    else:
        main()
