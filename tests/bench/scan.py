"""The spin scan's kernels: work, time and memory, against a numpy twin and PCL.

    uv run python tests/bench/scan.py
    uv run python tests/bench/scan.py --millions 2 10 50 --origins 0

Scenes: the paper's artificial one (250,000 points, without noise and with 5 cm), and level ground
at 1000 points per square metre with 3 cm noise, so that ground points see each other. The ground is
made and scanned in blocks of 2 million points with a halo of the radius: memory does not grow with
the scene. Every line is a process of its own; memory is its peak resident size.

Times are CPU seconds per thread, so other processes disturb them little, except "wall". A visit is
a point whose bin was computed. The "stream" column is a sum over the same coordinates, which
memory bounds, in nanoseconds a point; "index" is the sorting before the scan. PCL's
SpinImageEstimation runs on a part of the same origins where libpcl-dev and g++ are installed.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spinpipe.stages.artificial import SEED, make_scene
from spinpipe.stages.spin_image import (
    SpinGrid,
    SpinTemplate,
    correlation,
    spin_image,
    template_from_cloud,
)
from spinpipe.stages.spin_kernel import ScanWork, build_index, correlate

GRID = SpinGrid(2.5, 1.0, 0.1)
MIN_CORRELATION = 0.6
DENSITY = 1000
BLOCK_POINTS = 2_000_000
TWIN_ORIGINS = 100
PCL_ORIGINS = 500
COLUMNS = (
    ("scene", "{scene}"),
    ("points", "{points:,}"),
    ("per m2", "{density:.0f}"),
    ("method", "{method}"),
    ("threads", "{threads}"),
    ("origins", "{origins:,}"),
    ("visits/origin", "{visits_per_origin:,.0f}"),
    ("us/origin", "{us_per_origin:.2f}"),
    ("ns/visit", "{ns_per_visit:.3f}"),
    ("origins/s (wall)", "{per_second:,.0f}"),
    ("index ns/point", "{index_ns:.0f}"),
    ("stream ns/point", "{stream_ns:.2f}"),
    ("peak MB", "{peak_mb:.0f}"),
)

Cloud = NDArray[np.float32]


def ground_blocks(points: int) -> Iterator[tuple[Cloud, Cloud]]:
    """Blocks of level ground in a row along x: points with halo, and the block's own."""
    own = min(points, BLOCK_POINTS)
    count, side = round(points / own), (own / DENSITY) ** 0.5

    def block(number: int) -> Cloud:
        rng = np.random.default_rng(number)
        cloud = rng.random((own, 3), np.float32) * np.float32([side, side, 0])
        cloud[:, 0] += number * side
        cloud[:, 2] = rng.normal(0, 0.03, own)
        return cloud

    before = np.zeros((0, 3), np.float32)
    this = block(0)
    for number in range(count):
        after = block(number + 1) if number + 1 < count else np.zeros((0, 3), np.float32)
        left, right = number * side - GRID.radius_m, (number + 1) * side + GRID.radius_m
        halo = [before[before[:, 0] > left], this, after[after[:, 0] < right]]
        yield np.concatenate(halo), this
        before, this = this, after


def scene_blocks(scene: str, points: int) -> Iterator[tuple[Cloud, Cloud]]:
    """Blocks of a scene, see ``ground_blocks``."""
    if scene == "ground":
        yield from ground_blocks(points)
        return
    noise_m = 0.05 if scene == "artificial 5 cm" else 0.0
    cloud = make_scene(points, noise_m, np.random.default_rng(SEED)).xyz.astype(np.float32)
    yield cloud, cloud


def model_template() -> SpinTemplate:
    """Template of the artificial scene's first car."""
    scene = make_scene(20_000, 0.0, np.random.default_rng(SEED))
    return template_from_cloud(scene.models["model_1"].cloud, GRID)


def some_origins(own: Cloud, most: int) -> Cloud:
    """The origins nearest to the middle (neighbours, as in a whole scan), or all."""
    if not 0 < most < len(own):
        return own
    distance = np.linalg.norm(own[:, :2] - own[:, :2].mean(axis=0), axis=1)
    return own[np.argpartition(distance, most)[:most]]


def measure(scene: str, points: int, method: str, threads: int, most: int) -> dict[str, Any]:
    """One line of the table, in this process."""
    template = model_template()
    least = MIN_CORRELATION if method == "pruned" else None
    tiny = np.zeros((1, 3), np.float32)
    correlate(build_index(tiny), tiny, [template])  # compile or load
    work, cpu, wall, stream, sort, seen = ScanWork(), 0.0, 0.0, 0.0, 0.0, 0
    area = 0.0
    for around, own in scene_blocks(scene, points):
        origins = some_origins(own, most)
        rows = np.ascontiguousarray(own.T)
        start = time.process_time()
        float(rows.sum())
        stream += time.process_time() - start
        seen += len(own)
        area += float(np.prod(np.ptp(own[:, :2], axis=0)))
        start = time.process_time()
        index = build_index(around)
        sort += time.process_time() - start
        start_cpu, start = time.process_time(), time.perf_counter()
        if method == "numpy twin":
            origins = origins[:: max(1, len(origins) // TWIN_ORIGINS)]
            for origin in origins:
                correlation(spin_image(around, origin, GRID), template.values)
            work.origins += len(origins)
            work.visits += len(origins) * len(around)
        else:
            correlate(index, origins, [template], threads, min_correlation=least, work=work)
        cpu += time.process_time() - start_cpu
        wall += time.perf_counter() - start
    return {
        "scene": scene,
        "points": seen,
        "density": seen / area,
        "method": method,
        "threads": threads,
        "origins": work.origins,
        "visits_per_origin": work.visits / work.origins,
        "us_per_origin": cpu / work.origins * 1e6,
        "ns_per_visit": cpu / max(work.visits, 1) * 1e9,
        "per_second": work.origins / wall,
        "index_ns": sort / seen * 1e9,
        "stream_ns": stream / seen * 1e9,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def compile_pcl(folder: Path) -> Path | None:
    """Compile the peer, or say why not."""
    program = folder / "pcl_spin"
    source = Path(__file__).with_name("pcl_spin.cpp")
    if not shutil.which("g++") or not shutil.which("pkg-config"):
        print("PCL left out: no g++ or pkg-config")
        return None
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "pcl_features"], capture_output=True, text=True
    )
    if flags.returncode:
        print("PCL left out: no libpcl-dev")
        return None
    command = ["g++", "-O3", "-march=native", "-o", str(program), str(source)]
    built = subprocess.run([*command, *flags.stdout.split()], capture_output=True, text=True)
    if built.returncode:
        print("PCL left out: it does not compile:", built.stderr[-400:])
        return None
    return program


def measure_pcl(program: Path, folder: Path, scene: str, points: int) -> dict[str, Any]:
    """PCL on every n-th origin of the scene's first block."""
    around, _ = next(iter(scene_blocks(scene, points)))
    around.tofile(folder / "points.f32")
    numbers = np.arange(0, len(around), max(1, len(around) // PCL_ORIGINS), dtype=np.int32)
    numbers.tofile(folder / "indices.i32")
    out = subprocess.run(
        [program, folder / "points.f32", folder / "indices.i32", str(GRID.radius_m)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    return {
        "scene": scene,
        "points": len(around),
        "method": "PCL",
        "threads": 1,
        "origins": len(numbers),
        "us_per_origin": float(out[0]) / len(numbers) * 1e6,
        "per_second": len(numbers) / float(out[0]),
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
    scenes = (
        [] if options.no_artificial else [("artificial", 250_000), ("artificial 5 cm", 250_000)]
    )
    scenes += [("ground", int(millions * 1e6)) for millions in options.millions]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pcl = compile_pcl(folder)
        for scene, points in scenes:
            if points <= BLOCK_POINTS:
                run_one(scene, points, "numpy twin", 1, 0)
                if pcl:
                    print(line(measure_pcl(pcl, folder, scene, points)), flush=True)
            for method, most in (("exhaustive", options.origins), ("pruned", 0)):
                for threads in options.threads:
                    run_one(scene, points, method, threads, most if scene == "ground" else 0)


def run_one(*arguments: Any) -> None:
    """Measure one line in a process of its own and print it."""
    command = [sys.executable, __file__, "--one", json.dumps(arguments)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    print(line(json.loads(out)), flush=True)


def _processor() -> str:
    for text in Path("/proc/cpuinfo").read_text().splitlines():
        if text.startswith("model name"):
            return text.split(":")[1].strip()
    return platform.processor()


if __name__ == "__main__":
    main()
