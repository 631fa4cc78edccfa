"""Attacks on whole runs: kills, flipped bytes, full disks, and many runs one after the other.

    uv run python tests/fuzz/runs.py kills --times 200
    uv run python tests/fuzz/runs.py flips --times 5000
    uv run python tests/fuzz/runs.py full --sizes 40
    uv run python tests/fuzz/runs.py soak --times 500

Each prints one line of figures and ends with 1 if anything was lost, differed in silence, hung, or
was told in more than a sentence. Runs are forks of this process, which has imported and compiled
all: they work from their first moment on. Only half of the soak starts an interpreter each time.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from conftest import make_yard, run_command_line, without_progress

from spinpipe.pipeline.drawing import recording  # noqa: F401  # pyright: ignore[reportUnusedImport]  # for all forks
from spinpipe.pipeline.entry import main as main_of_process
from spinpipe.pipeline.errors import INTERNAL_ERROR

COMMAND = (sys.executable, "-c", "from spinpipe.pipeline.entry import main; main()")
RESULTS = ("detections.json", "detections.csv", "detections.ply")
PAGE = 4096
"""Bytes that a file system hands out at once."""
LIMIT_S = 300.0


class Fork:
    """The command line in a fork of this process; what it says on standard error is kept."""

    def __init__(self, *arguments: str, before: Callable[[], None] = lambda: None) -> None:
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  # open as long as this is
        self._pid = os.fork()
        if not self._pid:
            self._be(arguments, before)

    def _be(self, arguments: tuple[str, ...], before: Callable[[], None]) -> None:
        code: object = INTERNAL_ERROR
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            os.dup2(self._said.fileno(), 2)
            before()
            sys.argv = ["spinpipe", *arguments]
            main_of_process()
            code = 0
        except SystemExit as stop:
            code = stop.code or 0
        finally:
            os._exit(code if isinstance(code, int) else 1)

    def kill(self) -> None:
        os.kill(self._pid, signal.SIGKILL)
        os.waitpid(self._pid, 0)

    def end(self) -> tuple[int, str]:
        """Exit code and what was said, after it has ended."""
        began = time.monotonic()
        while not (status := os.waitpid(self._pid, os.WNOHANG))[0]:
            if time.monotonic() - began > LIMIT_S:
                self.kill()
                return -signal.SIGKILL, f"hangs for {LIMIT_S:.0f} s"
            time.sleep(0.01)
        self._said.seek(0)
        said = self._said.read().decode(errors="replace")
        return os.waitstatus_to_exitcode(status[1]), without_progress(said)


class Scene:
    """A small scene in a folder of its own, and what a run over it finds."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.config = make_yard().write(folder)
        self.output = folder / "run"
        self.options = ("run", str(self.config), "-o", str(self.output))
        assert run_command_line(*self.options, "--rerun", "off").code == 0
        assert not self.run()
        self.truth = folder / "truth.csv"
        self.truth.write_text("x,y\n-3.1,-2.6\n3.0,2.7\n")
        self.expected = self.results()

    def run(self) -> str:
        """Run to the end; what was wrong with how it ended."""
        code, said = Fork(*self.options).end()
        return f"code {code}: {said}" if code else ""

    def results(self) -> dict[str, bytes]:
        return {name: (self.output / name).read_bytes() for name in RESULTS}


def kills(scene: Scene, times: int, rng: random.Random) -> Counter[str]:
    """Kill at random instants; nothing finished is lost and the end is the same."""
    count: Counter[str] = Counter()
    shutil.rmtree(scene.output)
    began = time.monotonic()
    scene.run()
    whole_s = time.monotonic() - began
    for number in range(times):
        if number % 4 == 0:
            shutil.rmtree(scene.output)
        before = {path.name for path in scene.output.glob("*.mcap")}
        process = Fork(*scene.options)
        time.sleep(rng.uniform(0, (1.0, 0.7, 0.5, 0.5)[number % 4] * whole_s))
        process.kill()
        after = {path.name for path in scene.output.glob("*.mcap")}
        count["kills"] += 1
        count[f"with {len(after)} stages there"] += 1
        count["lost"] += len(before - after)
        if number % 4 == 3:
            wrong = scene.run()
            count["bad"] += bool(wrong) or scene.results() != scene.expected
            if wrong:
                print(f"BAD: does not go on after kill {number}: {wrong[:300]}", flush=True)
    return count


def flips(scene: Scene, times: int, rng: random.Random) -> Counter[str]:
    """Flip a bit or cut a file of a run, then use every command that reads it."""
    count: Counter[str] = Counter()
    out = str(scene.output)
    commands: dict[str, tuple[str, ...]] = {
        "run": (*scene.options, "--rerun", "off"),
        "eval": ("eval", out, "--truth", str(scene.truth)),
        "cut": ("model", "cut", out, "--at", "3,2.7,0", "--size", "5,2.5,2", "--out", "CUT"),
        "record": ("record", out),
        "why": ("why", out, "0"),
        "plant": ("plant", out, "--count", "1"),
    }
    cut = scene.folder / "cut.ply"
    copy = scene.folder / "copy"
    shutil.copytree(scene.output, copy)
    said: dict[str, str] = {}
    for name in ("eval", "cut", "why", "plant"):
        said[name] = _call(commands[name], cut).out + _digest(cut)
    shutil.rmtree(scene.output)
    shutil.copytree(copy, scene.output)
    names = [path.name for path in copy.iterdir() if path.is_file() and path.stat().st_size]
    for number in range(times):
        if number % 500 == 499:
            print(f"    so far {dict(count)}", flush=True)
        name = rng.choice(names)
        path = scene.output / name
        data = bytearray(path.read_bytes())
        at = rng.randrange(len(data))
        if rng.random() < 0.2:
            del data[at:]
        else:
            data[at] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        command = rng.choices(list(commands), (4, 14, 10, 2, 9, 1))[0]
        outcome = _call(commands[command], cut)
        count[command] += 1
        if outcome.code == 0:
            count["harmless"] += 1
            differs = command in said and outcome.out + _digest(cut) != said[command]
            if command == "run":
                differs = scene.results() != scene.expected
            if differs:
                count["silent"] += 1
                print(f"SILENT: {command} after damage of {name} at byte {at}", flush=True)
        elif outcome.code == 70 or outcome.err.count("\n") != 1:
            count["bad"] += 1
            print(f"BAD: {command} after {name} at {at}: {outcome.err[:200]}", flush=True)
        else:
            count["noticed"] += 1
        shutil.rmtree(scene.output)
        shutil.copytree(copy, scene.output)
    return count


def _call(command: tuple[str, ...], cut: Path):
    cut.unlink(missing_ok=True)
    return run_command_line(*(str(cut) if word == "CUT" else word for word in command))


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else ""


def full(scene: Scene, sizes: int, rng: random.Random) -> Counter[str]:
    """Let the disk be full after so many bytes: a small file system, or a limit on each file.

    Every size in turn: the message names a file, and with room the run goes on to the same end.
    Half of the runs start from nothing, half from the stages that had room, without a recording.
    """
    count: Counter[str] = Counter()
    used = sum(path.stat().st_size for path in scene.output.rglob("*") if path.is_file())
    mounted = _mount(scene.folder / "disk", used)
    copy = scene.folder / "copy"
    copy.mkdir()
    for name in (".spinpipe", "*.mcap"):
        for path in scene.output.glob(name):
            shutil.copy2(path, copy)
    for number in range(sizes):
        share = (number + rng.random()) / sizes
        shutil.rmtree(scene.output, ignore_errors=True)
        limit = int(share * used) + PAGE
        folder = scene.output
        if mounted:
            folder = scene.folder / "disk" / "run"
            shutil.rmtree(folder, ignore_errors=True)
            subprocess.run(["mount", "-o", f"remount,size={limit}", folder.parent], check=True)
        options = (*scene.options[:-1], str(folder))

        def limited(limit: int = limit) -> None:
            if not mounted:
                signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit // 4, limit // 4))

        if number % 2:
            folder.mkdir()
            room = limit
            for path in sorted(copy.iterdir()):
                room -= PAGE + math.ceil(path.stat().st_size / PAGE) * PAGE  # its entry, its data
                if room > 0:
                    shutil.copy2(path, folder)
        code, said = Fork(*options, before=limited).end()
        count["runs"] += 1
        if code and (code != 1 or said.count("\n") != 1 or str(folder) not in said):
            count["bad"] += 1
            print(f"BAD: at {limit} bytes: {code} {said[:300]}", flush=True)
        count["refused"] += code == 1
        if mounted:
            subprocess.run(["mount", "-o", f"remount,size={3 * used}", folder.parent], check=True)
        code, said = Fork(*options).end()
        same = not code and all((folder / n).read_bytes() == scene.expected[n] for n in RESULTS)
        if not same:
            count["bad"] += 1
            print(f"BAD: does not go on after {limit} bytes: {code} {said[:300]}", flush=True)
    if mounted:
        subprocess.run(["umount", scene.folder / "disk"], check=False)
    return count


def _mount(place: Path, size: int) -> bool:
    """Whether a file system of a given size could be made here."""
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", place]
    return os.geteuid() == 0 and subprocess.run(command, capture_output=True).returncode == 0


def soak(scene: Scene, times: int, rng: random.Random) -> Counter[str]:
    """Run again and again, half of it in this process: memory, threads and files do not pile up."""
    count: Counter[str] = Counter()
    seen: list[tuple[int, int, int]] = []
    for number in range(times):
        start = rng.choice(("ground", "cluster", "verify"))
        if number % 2:
            done = subprocess.run([*COMMAND, *scene.options], capture_output=True, timeout=LIMIT_S)
            count["bad"] += done.returncode != 0
        else:
            count["bad"] += run_command_line(*scene.options, "--from", start).code != 0
            seen.append(_held())
        count["runs"] += 1
    first, last = seen[len(seen) // 5], seen[-1]
    megabytes, threads, files = (b - a for a, b in zip(first, last, strict=True))
    count.update({"grown_MB": megabytes, "more_threads": threads, "more_files": files})
    count["bad"] += megabytes > 50 or threads > 4 or files > 64
    count["bad"] += scene.results() != scene.expected
    return count


def _held() -> tuple[int, int, int]:
    """Resident megabytes, threads and open files of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    counts = (len(list(Path(f"/proc/self/{what}").iterdir())) for what in ("task", "fd"))
    return (pages * resource.getpagesize() // 1_000_000, *counts)  # pyright: ignore


def main() -> None:
    """Attack as asked."""
    attacks = {"kills": kills, "flips": flips, "full": full, "soak": soak}
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("attack", choices=attacks)
    parser.add_argument("--times", "--sizes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        count = attacks[given.attack](Scene(Path(folder)), given.times, random.Random(given.seed))
    figures = ", ".join(f"{value} {name}" for name, value in count.items())
    print(f"{given.attack}: {figures}; {time.monotonic() - began:.0f} s")
    sys.exit(bool(count["bad"] or count["lost"] or count["silent"]))


if __name__ == "__main__":
    main()
