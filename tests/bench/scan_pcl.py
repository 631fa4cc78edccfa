"""PCL's SpinImageEstimation as a peer of the scan, where libpcl-dev and g++ are installed."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from scan_scenes import GRID, scene_blocks

PCL_ORIGINS = 500


def compile_pcl(
    folder: Path, name: str = "pcl_spin", module: str = "pcl_features", arch: str = "-march=native"
) -> Path | None:
    """Compile a peer, or say why not. What PCL compiled itself must be met without ``arch``."""
    program = folder / name
    source = Path(__file__).with_name(f"{name}.cpp")
    if not shutil.which("g++") or not shutil.which("pkg-config"):
        print("PCL left out: no g++ or pkg-config")
        return None
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", module], capture_output=True, text=True
    )
    if flags.returncode:
        print("PCL left out: no libpcl-dev")
        return None
    command = ["g++", "-O3", *arch.split(), "-o", str(program), str(source)]
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
    command = [program, folder / "points.f32", folder / "indices.i32", str(GRID.radius_m)]
    seconds = min(
        float(subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()[0])
        for _ in range(3)
    )
    return {
        "scene": scene,
        "points": len(around),
        "method": "PCL",
        "threads": 1,
        "origins": len(numbers),
        "us_per_origin": seconds / len(numbers) * 1e6,
        "per_second": len(numbers) / seconds,
    }
