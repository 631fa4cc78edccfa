"""Errors as the user sees them: one line and an exit code."""

from __future__ import annotations

import errno
import os
import traceback

from spinpipe.pipeline.config import ConfigError
from spinpipe.pipeline.mcap_file import DamagedFileError
from spinpipe.stages.stage import StageError

INPUT_ERROR = 1
USAGE_ERROR = 2
INTERNAL_ERROR = 70
"""EX_SOFTWARE of sysexits.h: a mistake of spinpipe itself."""
_MENDS = {
    errno.ENOSPC: "; free some and run again, what is complete stays",
    errno.EDQUOT: "; free some and run again, what is complete stays",
    errno.ELOOP: "; links that lead to each other, name the file itself",
}


def describe(error: BaseException) -> tuple[str, int]:
    """What to say in one line, and the exit code.

    Set ``SPINPIPE_TRACEBACK=1`` to see where an internal error came from.
    """
    text, code = _text_and_code(error)
    if code == INTERNAL_ERROR and os.environ.get("SPINPIPE_TRACEBACK"):
        return "".join(traceback.format_exception(error)), code
    # names in files may hold line ends, and escapes that turn a terminal red
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text), code


def _text_and_code(error: BaseException) -> tuple[str, int]:
    if isinstance(error, ConfigError):
        return str(error), USAGE_ERROR
    if isinstance(error, (StageError, DamagedFileError)):
        return str(error), INPUT_ERROR
    if isinstance(error, MemoryError):
        return (
            "out of memory: lower execution.memory_gb, execution.threads or record.preview_points",
            INPUT_ERROR,
        )
    if isinstance(error, OSError):
        mend = _MENDS.get(error.errno or 0, "")
        return f"{error.filename or 'input/output'}: {error.strerror or error}{mend}", INPUT_ERROR
    text = " ".join(str(error).split())
    return (
        f"internal error: {type(error).__name__}: {text} "
        "(a mistake of spinpipe; SPINPIPE_TRACEBACK=1 shows where)",
        INTERNAL_ERROR,
    )
