"""Other libraries beside spinpipe: instances found, false ones, CPU seconds, memory.

    uv run --group bench python tests/bench/peers.py --judge ../shared/judge
    uv run --group bench python tests/bench/peers.py --scenes demo --matchers spinpipe open3d

The judge's folder holds judge.py, which runs spinpipe by its commands and scores detections, and
table.json, which names scenes and labels. Peers get spinpipe's scene and model (what `spinpipe
model cut` wrote, or the mesh) and are scored by the same function. Every line is a process of its
own with a limit of CPU seconds; what it found until then counts. CPU seconds are those of all
threads, memory is the peak resident size. How the peers are used: ``peers_matchers.py``.
"""

from __future__ import annotations

import argparse
import csv
import datetime
import importlib.util
import json
import os
import platform
import resource
import signal
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

from peers_matchers import MATCHERS, MIN_FITNESS, search
from scan_pcl import compile_pcl

from spinpipe.pipeline.demo import write_example

SCENES = ("demo", "bus-yard", "prisms-north", "photo-west-init")
PACKAGES = ("opencv-contrib-python-headless", "open3d", "kiss-matcher")
HEAD = ("scene", "matcher", "labels", "found", "false", "at the best threshold", "CPU s", "peak MB")


def load_judge(folder: Path) -> Any:
    """The judge's program as a module."""
    spec = importlib.util.spec_from_file_location("judge", folder / "judge.py")
    assert spec
    assert spec.loader
    judge = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(judge)
    return judge


def demo_case(folder: Path) -> dict[str, Any]:
    """The demo's artificial scene as a case: its first model, cars of the second are decoys."""
    write_example(folder)
    with (folder / "truth.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["model"] == "model_1"]
    with (folder / "labels.csv").open("w") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    names = {"scene": "scene.ply", "model": "model_1.ply", "truth": "labels.csv"}
    paths = {key: str(folder / name) for key, name in names.items()}
    return {"name": "demo", "kind": "init", "radius": 1.5, **paths}


def limited(command: list[str], limit_s: int) -> dict[str, Any]:
    """Run a command: CPU seconds and peak memory with all its children, and how it ended."""
    limits = (limit_s, limit_s + 5)
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, limits),
    )
    assert process.stderr
    said = process.stderr.read().decode(errors="replace")
    _, status, used = os.wait4(process.pid, 0)
    cpu = used.ru_utime + used.ru_stime
    note = (said.strip().splitlines() or [""])[-1][-90:]
    if os.WIFSIGNALED(status):
        note = "limit reached" if cpu >= limit_s - 1 else signal.strsignal(os.WTERMSIG(status))
    return {"cpu_s": cpu, "peak_mb": used.ru_maxrss / 1024, "note": note if status else ""}


def scored(judge: Any, out: Path, case: dict[str, Any], data: Path) -> dict[str, Any]:
    """The judge's score of a run's folder, and found and false at the threshold of the best F1."""
    file, truth = out / "detections.json", data / case["truth"]
    if not file.exists():
        file.write_text('{"detections": []}')
    row = judge.score(out, truth, case["radius"])
    every = json.loads(file.read_text())["detections"]
    scores = sorted({d["score"] for d in every if d["fate"] == "accepted"})
    trial, best, best_f1 = out / "trial", row, -1.0
    trial.mkdir(exist_ok=True)
    for least in scores:
        kept = [d for d in every if d["score"] >= least]
        (trial / "detections.json").write_text(json.dumps({"detections": kept}))
        at = judge.score(trial, truth, case["radius"])
        f1 = 2 * at["found"] / (at["labels"] + at["found"] + at["false"])
        best, best_f1 = (at, f1) if f1 > best_f1 else (best, best_f1)
    return {**row, "best": f"{best['found']} / {best['false']}"}


def main() -> None:
    """Run what the options name and print a markdown table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--judge", type=Path, default=Path("../shared/judge"))
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES)
    parser.add_argument("--matchers", nargs="+", default=["spinpipe", *MATCHERS])
    parser.add_argument("--limit", type=int, default=240, help="CPU seconds a line")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    judge = load_judge(options.judge)
    if options.one:
        name, case, data, work = json.loads(options.one)
        if name == "spinpipe":
            run, said = judge.run_case(case, Path(data), Path(work))
            sys.exit(None if run else said)
        search(name, Path(work) / case["model"], Path(data) / case["scene"], Path(work) / name)
        return
    table = json.loads((options.judge / "table.json").read_text())
    data = (options.judge / table["data"]).resolve()
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    print(f"{datetime.date.today()}, Python {platform.python_version()}, {versions}; "
          f"accepted from fitness {MIN_FITNESS}, at most {options.limit} CPU s\n")  # fmt: skip
    print(f"| {' | '.join(HEAD)} |\n|---|---{'|---:' * (len(HEAD) - 2)}|")
    for name in options.scenes:
        with tempfile.TemporaryDirectory() as folder:
            work = Path(folder)
            cases = {case["name"]: case for case in table["cases"]}
            case = demo_case(work / "demo") if name == "demo" else cases[name]
            if case["kind"] == "init":
                case["model"] = str(data / case["model"])
            else:
                case["model"] = cut_model(judge, case, data, work)
            for matcher in options.matchers:
                if matcher == "pcl" and not compile_pcl(work, "pcl_match", "pcl_registration", ""):
                    continue
                out = work / ("run" if matcher == "spinpipe" else matcher)
                if matcher != "spinpipe":
                    out.mkdir()
                one = json.dumps([matcher, case, str(data), str(work)])
                command = [sys.executable, __file__, "--judge", str(options.judge), "--one", one]
                used = limited(command, options.limit)
                out.mkdir(exist_ok=True)
                row = {**scored(judge, out, case, data), **used}
                cells = (name.removesuffix("-init"), matcher, row["labels"], row["found"],
                         row["false"], row["best"], f"{row['cpu_s']:.0f} {row['note']}".strip(),
                         f"{row['peak_mb']:.0f}")  # fmt: skip
                print(f"| {' | '.join(map(str, cells))} |", flush=True)


def cut_model(judge: Any, case: dict[str, Any], data: Path, work: Path) -> str:
    """The model that the judge's own case cuts, cut beforehand for the peers."""
    config = judge.config(work / "before.toml", data / case["scene"], 'shape = "saloon"')
    commands = (
        ("run", config, "--until", "ground", "--output", work / "before", "--rerun", "off"),
        ("model", "cut", work / "before", "--at", case["at"], "--size", case["size"],
         "--heading", case["heading"], "--name", "thing", "--out", work / "cut.ply"),
    )  # fmt: skip
    for command in commands:
        failed, said = judge.spinpipe(*command)
        if failed:
            sys.exit(said)
    return str(work / "cut.ply")


if __name__ == "__main__":
    main()
