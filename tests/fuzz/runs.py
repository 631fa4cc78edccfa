"""Attacks on whole runs: kills, flipped bytes, full disks, and many runs one after the other.

    uv run python tests/fuzz/runs.py kills --times 200
    uv run python tests/fuzz/runs.py flips --times 5000
    uv run python tests/fuzz/runs.py full --sizes 40
    uv run python tests/fuzz/runs.py soak --times 500

Each prints one line of figures and ends with 1 if anything was lost, differed in silence, hung, or
was told in more than a sentence.
"""

from __future__ import annotations

import argparse
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
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from conftest import make_yard, run_command_line, without_progress

COMMAND = (sys.executable, "-c", "from spinpipe.pipeline.entry import main; main()")
RESULTS = ("detections.json", "detections.csv", "detections.ply")
LIMIT_S = 300.0


class Scene:
    """A small scene in a folder of its own, and what a run over it finds."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.config = make_yard().write(folder)
        self.output = folder / "run"
        self.run()
        self.truth = folder / "truth.csv"
        self.truth.write_text("x,y\n-3.1,-2.6\n3.0,2.7\n")
        self.expected = self.results()

    def command(self, *more: str) -> list[str]:
        return [*COMMAND, "run", str(self.config), "-o", str(self.output), *more]

    def run(self) -> str:
        """Run to the end; what was wrong with how it ended."""
        done = subprocess.run(self.command(), capture_output=True, text=True, timeout=LIMIT_S)
        return "" if done.returncode == 0 else f"code {done.returncode}: {done.stderr}"

    def results(self) -> dict[str, bytes]:
        return {name: (self.output / name).read_bytes() for name in RESULTS}


def kills(scene: Scene, times: int, rng: random.Random) -> Counter[str]:
    """Kill at random instants; nothing finished is lost and the end is the same."""
    count: Counter[str] = Counter()
    began = time.monotonic()
    scene.run()
    whole_s = time.monotonic() - began
    for number in range(times):
        if number % 4 == 0:
            shutil.rmtree(scene.output)
        process = subprocess.Popen(
            scene.command(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        before = {path.name for path in scene.output.glob("*.mcap")}
        time.sleep(rng.uniform(0, 1.2 * whole_s))
        process.send_signal(signal.SIGKILL)
        process.wait()
        after = {path.name for path in scene.output.glob("*.mcap")}
        count["kills"] += 1
        count["lost"] += len(before - after)
        if number % 4 == 3:
            count["bad"] += bool(scene.run()) or scene.results() != scene.expected
    return count


def flips(scene: Scene, times: int, rng: random.Random) -> Counter[str]:
    """Flip a bit or cut a file of a run, then use every command that reads it."""
    count: Counter[str] = Counter()
    out = str(scene.output)
    commands: dict[str, tuple[str, ...]] = {
        "run": ("run", str(scene.config), "-o", out, "--rerun", "off"),
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
    for name in ("eval", "cut", "why"):
        said[name] = _call(commands[name], cut).out
    names = [path.name for path in copy.iterdir() if path.is_file() and path.stat().st_size]
    for _ in range(times):
        name = rng.choice(names)
        path = scene.output / name
        data = bytearray(path.read_bytes())
        at = rng.randrange(len(data))
        if rng.random() < 0.2:
            del data[at:]
        else:
            data[at] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        command = rng.choices(list(commands), (4, 6, 4, 1, 4, 1))[0]
        outcome = _call(commands[command], cut)
        count[command] += 1
        if outcome.code == 0:
            count["harmless"] += 1
            differs = command in said and outcome.out != said[command]
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


def full(scene: Scene, sizes: int, rng: random.Random) -> Counter[str]:
    """Let the disk be full after so many bytes: a small file system, or a limit on each file.

    Every size in turn: the message names a file, and with room the run goes on to the same end.
    """
    count: Counter[str] = Counter()
    used = sum(path.stat().st_size for path in scene.output.rglob("*") if path.is_file())
    mounted = _mount(scene.folder / "disk", used)
    for number in range(sizes):
        share = (number + rng.random()) / sizes
        shutil.rmtree(scene.output, ignore_errors=True)
        limit = int(share * used) + 4096
        folder = scene.output
        if mounted:
            folder = scene.folder / "disk" / "run"
            shutil.rmtree(folder, ignore_errors=True)
            subprocess.run(["mount", "-o", f"remount,size={limit}", folder.parent], check=True)
        command = [*COMMAND, "run", str(scene.config), "-o", str(folder)]

        def limited(limit: int = limit) -> None:
            if not mounted:
                signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit // 4, limit // 4))

        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=LIMIT_S, preexec_fn=limited
            )
        except subprocess.TimeoutExpired:
            count["bad"] += 1
            print(f"BAD: hangs at {limit} bytes", flush=True)
            continue
        count["runs"] += 1
        said = without_progress(done.stderr)
        if done.returncode and (said.count("\n") != 1 or str(folder) not in said):
            count["bad"] += 1
            print(f"BAD: at {limit} bytes: {said[:300]}", flush=True)
        count["refused"] += done.returncode == 1
        if mounted:
            subprocess.run(["mount", "-o", f"remount,size={3 * used}", folder.parent], check=True)
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
        same = all((folder / n).read_bytes() == scene.expected[n] for n in RESULTS)
        if done.returncode or not same:
            count["bad"] += 1
            print(f"BAD: does not go on after {limit} bytes: {done.stderr[:300]}", flush=True)
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
    options = ("run", str(scene.config), "-o", str(scene.output))
    for number in range(times):
        start = rng.choice(("ground", "cluster", "verify"))
        if number % 2:
            count["bad"] += bool(scene.run())
        else:
            count["bad"] += run_command_line(*options, "--from", start).code != 0
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
