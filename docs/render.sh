#!/bin/sh
# Render docs/picture.png again from the demo's recording: docs/render.sh [RUN]
# Needs a Vulkan driver; the software one will do: apt-get install mesa-vulkan-drivers libvulkan1
set -eu
cd "$(dirname "$0")/.."
run=${1:-recordings/demo}
[ -e "$run/run.rrd" ] || uv run spinpipe demo --output "$run"
uv run python - "$run/run.rrd" docs/picture.png <<'END'
import sys
from pathlib import Path

from spinpipe.pipeline.drawing.render import render

recording, picture = map(Path, sys.argv[1:])
sys.exit("\n".join(render(recording, picture, timeline="candidate", step=20_000)) or 0)
END
