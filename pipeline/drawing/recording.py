"""The Rerun recording of a run: where it goes, and what is drawn into it.

Rerun is imported when it is first needed: the command's help and a run without recording do not
wait for it.
"""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING, Literal
from urllib.parse import urlsplit
from weakref import WeakKeyDictionary

from spinpipe.pipeline.atomic import naming
from spinpipe.stages.stage import StageError

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from spinpipe.pipeline.drawing.drawing import Reader
    from spinpipe.pipeline.drawing.threshold import Truth

APPLICATION_ID = "spinpipe"
DEFAULT_URL = "rerun+http://127.0.0.1:9876/proxy"

_FLUSH_S = 10.0
"""Without a byte written meanwhile nothing more will be."""
_END, _END_BYTES = b"RRF2FOOT", 64
"""How a complete file ends [Rerun 0.41, re_log_encoding]."""

_DISPLAYS = {"DISPLAY", "WAYLAND_DISPLAY"}
_streams: WeakKeyDictionary[rr.RecordingStream, rr.BinaryStream] = WeakKeyDictionary()
"""What recordings that are only saved have encoded: written at their end, by us."""

RecordMode = Literal["save", "spawn", "connect", "off"]


def open_recording(
    run_name: str, mode: RecordMode, path: Path, url: str | None = None
) -> rr.RecordingStream | None:
    """Open the recording of a run.

    Parameters
    ----------
    run_name : becomes the recording's id: drawing a run again replaces it in an open viewer
    mode : ``save`` writes ``path``; ``spawn`` also starts a viewer on this machine and ``connect``
        also sends to one that runs at ``url``; ``off`` records nothing
    path : file to write; an existing one is overwritten
    url : of a running viewer, by default the one of this machine

    Returns
    -------
    The recording, to be closed by ``close_recording``, or ``None`` for ``off``.

    Raises
    ------
    StageError
        When the file cannot be created, or when no viewer answers at ``url``.
    """
    if mode == "off":
        return None
    if mode == "connect":
        _check_viewer(url or DEFAULT_URL)
    if mode == "spawn" and sys.platform == "linux" and not os.environ.keys() & _DISPLAYS:
        raise StageError("--rerun spawn: no display here; use --rerun save and open run.rrd later")
    import rerun as rr
    import rerun_bindings

    rerun_bindings.flush_and_cleanup_orphaned_recordings()  # they keep their threads otherwise
    rec = rr.RecordingStream(APPLICATION_ID, recording_id=run_name)
    # a run has no clock: only the timelines of ``drawing`` exist
    rec.set_log_time_enabled(False)
    rec.set_log_tick_enabled(False)
    rec.send_recording_name(run_name)
    try:
        path.write_bytes(b"")
    except OSError as error:
        raise StageError(f"{path}: the recording cannot be written: {error.strerror}") from None
    if mode == "save":
        # Rerun's own writer of files waits for ever once the disk is full
        _streams[rec] = rec.binary_stream()
        return rec
    if mode == "spawn":
        rr.spawn(connect=False, executable_path=find_viewer(), recording=rec)
    rec.set_sinks(rr.FileSink(str(path)), rr.GrpcSink(url or DEFAULT_URL))
    return rec


def record_stage(
    stage: str,
    read: Reader,
    rec: rr.RecordingStream,
    preview_points: int,
    truth: Truth | None = None,
) -> None:
    """Draw the messages of a finished stage; the layout follows as soon as bounds are known."""
    from spinpipe.pipeline.drawing.blueprint import build_blueprint
    from spinpipe.pipeline.drawing.draw import DRAW
    from spinpipe.pipeline.drawing.verify import draw as draw_verify

    if stage == "verify" and truth is not None:
        draw_verify(read, rec, preview_points, truth)
    else:
        DRAW[stage](read, rec, preview_points)
    if stage in ("ingest", "model", "ground"):  # for the cloud, the views of models, the upright
        _send_blueprint(rec, build_blueprint(read, preview_points))


def _send_blueprint(rec: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
    """``rec.send_blueprint``, which keeps the stream that it makes, with two threads, for ever."""
    import rerun as rr
    import rerun_bindings

    stream = rr.RecordingStream._from_native(  # pyright: ignore[reportPrivateUsage]
        rerun_bindings.new_blueprint(APPLICATION_ID, make_default=False, make_thread_default=False)
    )
    stream.set_time("blueprint", sequence=0)
    blueprint._log_to_stream(stream)  # pyright: ignore[reportPrivateUsage]
    storage = stream.memory_recording().storage
    rerun_bindings.send_blueprint(storage, True, True, recording=rec.to_native())
    stream.disconnect()  # what it wrote to holds it otherwise


def close_recording(rec: rr.RecordingStream, path: Path) -> None:
    """Write everything out and end the recording: the file is complete then.

    Where Rerun writes the file itself, beside a viewer, it neither tells of a full disk nor comes
    back from one: the file must go on growing while it is written out, and bear the mark of a
    complete one at its end.

    Raises
    ------
    StageError
        When the file could not be written. A viewer that was closed meanwhile is no error.
    """
    if (stream := _streams.pop(rec, None)) is not None:
        data = stream.read(flush=True)
        rec.disconnect()
        with naming(path.with_suffix("")):
            path.write_bytes(data or b"")
        return
    size = -1
    while size < (size := path.stat().st_size):
        try:
            rec.flush(timeout_sec=_FLUSH_S)
            break
        except (RuntimeError, ValueError, TimeoutError) as error:
            if "gRPC" in str(error):
                break
    rec.disconnect()
    with path.open("rb") as file:
        file.seek(-min(_END_BYTES, path.stat().st_size), os.SEEK_END)
        if _END not in file.read():
            raise StageError(
                f"{path.with_suffix('')}: the recording could not be written in full; "
                "is the disk full?"
            )


def _check_viewer(url: str) -> None:
    """Fail at once: a recording to a viewer that is not there would only fail at its end."""
    where = urlsplit(url)
    try:
        with socket.create_connection((where.hostname or "", where.port or 9876), timeout=3):
            return
    except (OSError, ValueError) as error:
        raise StageError(
            f"no Rerun viewer answers at {url} ({error}): start one with `rerun`, "
            "or record with --rerun save"
        ) from error


def find_viewer() -> str | None:
    """Find the viewer that came with the SDK: its environment may not be on the search path."""
    beside = Path(sys.executable).with_name("rerun")
    return which("rerun") or (str(beside) if beside.exists() else None)
