"""How long the import of a cloud takes, beside a bare read of the same file and an MCAP write.

    uv run python tests/bench/reading.py [--millions 5]

"bare" reads the file with numpy or laspy, writes what the import wrote with the same writer, and
flushes it to the disk. The import beside that looks twice at the cloud, sorts it into tiles and
reads back what it wrote.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np

from spinpipe.pipeline.commands import run_command
from spinpipe.pipeline.mcap_file import Messages, StageFileWriter
from spinpipe.schemas import CLOUD
from spinpipe.stages.ingest.tiling import POINT

HEADER = (
    "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
    "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
)

MODEL = "[[model]]\nname = 'car'\nshape = 'saloon'\n"


def write_clouds(folder: Path, count: int) -> dict[str, Path]:
    """The same cloud as binary PLY, LAS and LAZ: rough ground of 0.05 m spacing, coloured."""
    rng = np.random.default_rng(0)
    side_m = 0.05 * count**0.5
    rows = np.zeros(count, POINT)
    rows["xyz"] = rng.uniform(0, (side_m, side_m, 0.2), (count, 3))
    rows["rgb"] = rng.integers(0, 256, (count, 3))
    (folder / "cloud.ply").write_bytes(HEADER.format(count).encode() + rows.tobytes())
    cloud = laspy.create(point_format=2, file_version="1.2")
    cloud.header.scales = np.full(3, 0.001)
    cloud.xyz = rows["xyz"].astype(np.float64)
    cloud.red, cloud.green, cloud.blue = rows["rgb"].astype(np.uint16).T * 257
    for suffix in ("las", "laz"):
        cloud.write(folder / f"cloud.{suffix}")
    return {path.suffix: path for path in sorted(folder.glob("cloud.*"))}


def bare_s(path: Path, messages: list[bytes]) -> float:
    """Seconds of a read into memory and of writing what the import wrote."""

    def read() -> object:
        if path.suffix != ".ply":
            cloud = laspy.read(path)
            return cloud.xyz, np.column_stack([cloud.red, cloud.green, cloud.blue])
        rows = np.fromfile(path, POINT, offset=path.read_bytes()[:400].index(b"end_header\n") + 11)
        return rows["xyz"].astype(np.float64), rows["rgb"].copy()

    def write() -> None:
        target = path.with_suffix(".mcap")
        writer = StageFileWriter(target, {})
        for message in messages:
            writer.write_bytes(CLOUD, message)
        writer.abandon()
        with target.open("rb") as file:
            os.fsync(file.fileno())

    return timed(read) + timed(write)


def timed(function: Callable[[], object]) -> float:
    """Wall seconds of a call."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--millions", type=int, default=5)
    options = parser.parse_args()
    print("| file | points | import | bare | share | import, ns a point |")
    print("|---|---:|---:|---:|---:|---:|")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        count = options.millions * 1_000_000
        for suffix, path in write_clouds(folder, count).items():
            config = folder / "config.toml"
            config.write_text(f"[ingest]\nscene = '{path}'\n{MODEL}")
            output = folder / suffix[1:]

            def run(config: Path = config, output: Path = output) -> None:
                run_command(config, output, [], "ingest", "ingest", "off", False)

            run()  # what is compiled and imported counts for nobody
            import_s = timed(run)
            encoded = [
                CLOUD.encode(tile).SerializeToString()
                for tile in Messages(output / "01_ingest.mcap", CLOUD)
            ]
            least_s = bare_s(path, encoded)
            print(
                f"| {suffix[1:].upper()} | {count:,} | {import_s:.2f} s | {least_s:.2f} s "
                f"| {least_s / import_s:.2f} | {1e9 * import_s / count:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
