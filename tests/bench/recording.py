"""What the recording of a finished run costs: processor time by stage, and size.

uv run python tests/bench/recording.py RUN [RUN ...]
"""

from __future__ import annotations

import sys
import time
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

from spinpipe.pipeline.context import RunReader
from spinpipe.pipeline.drawing.recording import close_recording, open_recording, record_stage
from spinpipe.pipeline.results.complete import open_complete
from spinpipe.stages import STAGES


def main() -> None:
    """Draw each run into a file that is thrown away."""
    for run in sys.argv[1:]:
        folder, config = open_complete(Path(run))
        with TemporaryDirectory() as scratch:
            path = Path(scratch) / "run.rrd"
            times = [time.process_time()]
            recording = open_recording(config.run.name, "save", path)
            assert recording is not None
            for stage in STAGES:
                read = RunReader(folder)
                record_stage(stage.name, read, recording, config.record.preview_points)
                times.append(time.process_time())
            close_recording(recording, path)
            times.append(time.process_time())
            parts = [f"{b - a:.2f}" for a, b in pairwise(times)]
            size = path.stat().st_size / 1e6
            print(f"{run}: {times[-1] - times[0]:.2f} s ({' '.join(parts)}), {size:.1f} MB")


if __name__ == "__main__":
    main()
