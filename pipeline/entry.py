"""Where the command starts: signals and standard streams, before anything heavy is imported.

A signal ends the process from a thread of its own, which needs no turn of the main thread: that
one may sit in a kernel or an import for seconds. What may be half written then is what a kill
may leave too, and every run copes with that.
"""

from __future__ import annotations

import io
import os
import shutil
import signal
import sys
import threading
from typing import Any

INTERRUPTED = "spinpipe: interrupted; run it again to go on\n"
_SHOW_CURSOR = "\x1b[?25h"
"""Progress bars hide it."""


def main() -> None:
    """Run the command line as a process of its own."""
    end_on_signals()
    sys.stdout = _tolerant_stdout()
    if not sys.warnoptions:
        import warnings

        warnings.simplefilter("ignore")  # of libraries: what matters to a user is said as an error
    os.environ.setdefault("RUST_LOG", "off")  # Rerun's own lines: what it cannot do is checked
    from spinpipe.pipeline.cli import main as run

    run()


def end_on_signals() -> None:
    """INT, TERM and HUP end the process at once with one sentence; ignored ones stay ignored."""
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, lambda *_: None)  # Python notes only signals with a handler
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_end, args=(reader,), daemon=True).start()


def _end(reader: int) -> None:
    number = os.read(reader, 1)[0]
    atomic = sys.modules.get("spinpipe.pipeline.atomic")  # to import could wait for a lock
    for path in list(getattr(atomic, "unfinished", ())):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)
    cursor = _SHOW_CURSOR if os.isatty(2) else ""
    os.write(2, (cursor + INTERRUPTED).encode())
    os._exit(128 + number)


class _Stdout(io.FileIO):
    """Standard output whose reader may go away: what comes then is dropped, the work goes on."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())  # and not again at exit
            if isinstance(error, BrokenPipeError):
                return len(data)
            error.filename = "standard output"
            raise


def _tolerant_stdout() -> io.TextIOBase:
    """Standard output that survives a closed pipe, no pipe at all and names that are not UTF-8."""
    try:
        raw = _Stdout(1, "w", closefd=False)
    except OSError:  # closed by whoever started us
        return io.StringIO()
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=encoding,
        errors="backslashreplace",
        line_buffering=raw.isatty(),
    )
