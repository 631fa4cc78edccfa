"""Colours of the recording, told apart also by the colour-blind.

Fates and marks take their hues from [Okabe & Ito 2008, Color Universal Design], with different
brightness; line widths say the same a second time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from spinpipe.schemas.arrays import U8

Colour = tuple[int, ...]
"""Red, green, blue and perhaps alpha, 0..255."""

BACKGROUND = (22, 25, 31)
ACCEPTED = (0, 205, 150)
AMBIGUOUS = (240, 200, 50)
DUPLICATE = (140, 130, 200)
REJECTED = (200, 80, 25)
MARK = (86, 180, 233)
HIT = (230, 100, 190)
GROUND = (86, 180, 233, 25)
SHADOW = (58, 62, 70)
PALE = (150, 160, 175)
WHITE = (245, 245, 245)

FATES = {
    "accepted": ACCEPTED,
    "ambiguous": AMBIGUOUS,
    "duplicate": DUPLICATE,
    "rejected": REJECTED,
}
"""From what matters most to what matters least."""
KEPT = ("accepted", "ambiguous")

EXPLAINED, UNEXPLAINED, GROUND_POINT = (90, 210, 250), (255, 140, 60), (120, 130, 120)
SEEN, CONTRADICTED, NOT_OBSERVED = (0, 205, 150), (230, 60, 90), (110, 115, 125)

SERIES = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (213, 94, 0),
)
"""Colours for curves that stand side by side, in turn."""


def fate_colour(fate: str) -> Colour:
    """Colour of a fate."""
    return FATES.get(fate, PALE)


def rank(fate: str) -> int:
    """Place of a fate: what matters most first."""
    return list(FATES).index(fate) if fate in FATES else len(FATES)


def shade(values: ArrayLike, low: float, high: float) -> U8:
    """Greys from dark to bright for (N,) values from ``low`` to ``high``: (N, 3) uint8."""
    share = (np.asarray(values, np.float64) - low) / max(high - low, 1e-9)
    grey = (70 + 170 * np.clip(share, 0, 1)).astype(np.uint8)
    return np.repeat(grey[:, None], 3, axis=1)


def series(count: int) -> U8:
    """Colours (count, 3) for curves side by side, repeating after the last."""
    return np.array([SERIES[i % len(SERIES)] for i in range(count)], np.uint8).reshape(-1, 3)
