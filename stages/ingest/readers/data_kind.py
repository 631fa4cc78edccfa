"""Whether the data behind a header are text or binary, whatever the header says."""

from __future__ import annotations

import re
from pathlib import Path

_SAMPLE = 1 << 16
_ENOUGH = 32
"""Bytes that are not all printable by chance."""
_NO_TEXT = re.compile(rb"[^\t\n\r\x20-\x7e]")
_MOST_ODD = 0.05
"""Share of other bytes that a text may have: names in other encodings."""
_LINE_ENDS = 8
"""In numbers a line feed follows a carriage return once in 256 times, not as often as this."""


def why_not(path: Path, offset: int, text: bool) -> str:
    """Why the data from ``offset`` on are not what the header says; empty where they may be."""
    with path.open("rb") as file:
        file.seek(offset)
        data = file.read(_SAMPLE)
    odd = len(_NO_TEXT.findall(data))
    if text:
        return (
            "its header says ascii, but its data are binary" if odd > _MOST_ODD * len(data) else ""
        )
    if not odd and len(data) >= _ENOUGH:
        return "its header says binary, but its data are text"
    if _LINE_ENDS <= data.count(b"\n") == data.count(b"\r\n"):
        return "its line ends were translated as if it were text; copy it again in binary mode"
    return ""


def left_over(size: int, end: int, row: int, points: int) -> tuple[str, ...]:
    """A note where a file goes on behind its points by as much as further points take."""
    if size - end < row or not row:
        return ()
    return (
        f"odd: its header says {points:,} points, what follows them has the size of "
        f"{(size - end) // row:,} more: if they are missing, export it again",
    )
