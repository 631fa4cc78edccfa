"""The spin scan's kernels: work, time and memory, against a numpy twin and PCL.

    uv run python tests/bench/scan.py
    uv run python tests/bench/scan.py --millions 2 10 50 --origins 0

Scenes: see ``scan_scenes.py``. Every line is a process of its own; memory is its peak resident
size. Times are CPU seconds per thread, so other processes disturb them little, except "wall"; of
scenes below a million points they are the least of three measurements, PCL's too.

A visit is a point whose bin was computed. "work" is visits against the exhaustive scan of the same
origins, "hits" what a method keeps of its hits. The "stream" column is a sum over the same
coordinates, which memory bounds, in nanoseconds a point; "index" is the sorting before the scan.
PCL's SpinImageEstimation runs on a part of the same origins; "PCL" is its time over the line's.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scan_pcl import compile_pcl, measure_pcl
from scan_scenes import BLOCK_POINTS, GRID, Cloud, model_template, scene_blocks

from spinpipe.stages.scan.coarse_to_fine import VOXEL_RADII, correlate_coarse_to_fine
from spinpipe.stages.scan.correlate import ScanWork, build_index, correlate
from spinpipe.stages.scan.image import correlation, spin_image

MIN_CORRELATION = 0.6
TWIN_ORIGINS = 100
REPEAT_BELOW = 1_000_000
COLUMNS = (
    ("scene", "{scene}"),
    ("points", "{points:,}"),
    ("per m2", "{density:.0f}"),
    ("method", "{method}"),
    ("threads", "{threads}"),
    ("origins", "{origins:,}"),
    ("visits/origin", "{visits_per_origin:,.0f}"),
    ("work", "1/{less_work:.1f}"),
    ("hits", "{kept:.1%}"),
    ("us/origin", "{us_per_origin:.2f}"),
    ("ns/visit", "{ns_per_visit:.3f}"),
    ("PCL", "{pcl_ratio:.0f} x"),
    ("origins/s (wall)", "{per_second:,.0f}"),
    ("index ns/point", "{index_ns:.0f}"),
    ("stream ns/point", "{stream_ns:.2f}"),
    ("peak MB", "{peak_mb:.0f}"),
)


def some_origins(own: Cloud, most: int) -> Cloud:
    """The origins nearest to the middle (neighbours, as in a whole scan), or all."""
    if not 0 < most < len(own):
        return own
    distance = np.linalg.norm(own[:, :2] - own[:, :2].mean(axis=0), axis=1)
    return own[np.argpartition(distance, most)[:most]]


def measure(scene: str, points: int, method: str, threads: int, most: int) -> dict[str, Any]:
    """One line of the table, in this process."""
    tiny = np.zeros((1, 3), np.float32)
    scan(method, tiny, tiny, 1, ScanWork())  # compile or load
    work, cpu, wall, stream, sort, seen, hits = ScanWork(), 0.0, 0.0, 0.0, 0.0, 0, 0
    area = 0.0
    for around, own in scene_blocks(scene, points):
        origins = some_origins(own, most)
        if method == "numpy twin":
            origins = origins[:: max(1, len(origins) // TWIN_ORIGINS)]
        rows = np.ascontiguousarray(own.T)
        start = time.process_time()
        float(rows.sum())
        stream += time.process_time() - start
        seen += len(own)
        area += float(np.prod(np.ptp(own[:, :2], axis=0)))
        tries = [
            scan(method, around, origins, threads, ScanWork())
            for _ in range(3 if points < REPEAT_BELOW and method != "numpy twin" else 1)
        ]
        best = min(tries, key=lambda row: row["cpu"])
        for name in ("origins", "visits"):
            setattr(work, name, getattr(work, name) + getattr(best["work"], name))
        cpu, wall, sort = cpu + best["cpu"], wall + best["wall"], sort + best["sort"]
        hits += best["hits"]
    return {
        "scene": scene,
        "points": seen,
        "density": seen / area,
        "method": method,
        "threads": threads,
        "origins": work.origins,
        "hit_count": hits,
        "visits_per_origin": work.visits / work.origins,
        "us_per_origin": cpu / work.origins * 1e6,
        "ns_per_visit": cpu / max(work.visits, 1) * 1e9,
        "per_second": work.origins / wall,
        "index_ns": sort / seen * 1e9,
        "stream_ns": stream / seen * 1e9,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def scan(
    method: str, around: Cloud, origins: Cloud, threads: int, work: ScanWork
) -> dict[str, Any]:
    """Scan once: CPU and wall seconds, CPU seconds of the sorting before, hits, work."""
    template = model_template()
    start = time.process_time()
    index = build_index(around)
    sort = time.process_time() - start
    start_cpu, start = time.process_time(), time.perf_counter()
    if method == "numpy twin":
        images = [spin_image(around, origin, GRID) for origin in origins]
        found = np.array([[correlation(image, template.images[0]) for image in images]])
        work.origins, work.visits = len(origins), len(origins) * len(around)
    elif method == "voxel":
        own = np.ones(len(origins), bool)
        found = correlate_coarse_to_fine(
            index, origins, own, template, threads,
            min_correlation=MIN_CORRELATION, voxel_m=VOXEL_RADII * GRID.radius_m, work=work,
        )  # fmt: skip
        work.origins = len(origins)
    else:
        least = MIN_CORRELATION if method == "pruned" else None
        found = correlate(index, origins, template, threads, min_correlation=least, work=work)
    return {
        "cpu": time.process_time() - start_cpu,
        "wall": time.perf_counter() - start,
        "sort": sort,
        "hits": int((found >= np.float32(MIN_CORRELATION)).sum()),
        "work": work,
    }


def line(row: dict[str, Any]) -> str:
    """A row as a line of a markdown table; what was not measured is a dash."""
    cells = []
    for _, form in COLUMNS:
        try:
            cells.append(form.format(**row))
        except KeyError:
            cells.append("-")
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Measure what the options name and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--millions", type=float, nargs="*", default=[2, 10])
    parser.add_argument("--threads", type=int, nargs="*", default=[1, 2])
    parser.add_argument(
        "--origins", type=int, default=20_000, help="exhaustive: most a block, 0 for all"
    )
    parser.add_argument("--no-artificial", action="store_true")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(*json.loads(options.one))))
        return
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parent,
    ).stdout.strip()
    print(f"{_processor()}, Python {platform.python_version()}, commit {commit}\n")
    print("| " + " | ".join(name for name, _ in COLUMNS) + " |")
    print("|" + "---|" * len(COLUMNS))
    scenes = [(name, 250_000) for name in ("artificial", "artificial 5 mm", "artificial 5 cm")]
    scenes.append(("street", 2_382_359))
    scenes = [] if options.no_artificial else scenes
    scenes += [("ground", int(millions * 1e6)) for millions in options.millions]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pcl = compile_pcl(folder)
        for scene, points in scenes:
            peer = None
            if pcl and (points <= BLOCK_POINTS or scene != "ground"):
                peer = measure_pcl(pcl, folder, scene, points)
                print(line(peer), flush=True)
            if points <= BLOCK_POINTS:
                run_one(scene, points, "numpy twin", 1, 0, peer=peer)
            most = options.origins if scene == "ground" else 0
            plain = None
            for method in ("exhaustive", "pruned", "voxel"):
                for threads in options.threads:
                    row = run_one(
                        scene, points, method, threads, most if method == "exhaustive" else 0,
                        peer=peer, plain=plain,
                    )  # fmt: skip
                    plain = plain or row


def run_one(
    *arguments: Any, peer: dict[str, Any] | None = None, plain: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Measure one line in a process of its own and print it beside PCL and the plain scan."""
    command = [sys.executable, __file__, "--one", json.dumps(arguments)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    row = json.loads(out)
    if peer:
        row["pcl_ratio"] = peer["us_per_origin"] / row["us_per_origin"]
    if plain:
        row["less_work"] = plain["visits_per_origin"] / row["visits_per_origin"]
        if plain["hit_count"] and plain["origins"] == row["origins"]:
            row["kept"] = row["hit_count"] / plain["hit_count"]
    print(line(row), flush=True)
    return row


def _processor() -> str:
    for text in Path("/proc/cpuinfo").read_text().splitlines():
        if text.startswith("model name"):
            return text.split(":")[1].strip()
    return platform.processor()


if __name__ == "__main__":
    main()
