"""Words spread evenly: what is drawn by a hash does not depend on the order of a cloud."""

from __future__ import annotations

import numpy as np

from spinpipe.schemas.arrays import U64

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""2^64 over the golden ratio: SplitMix64's step from one state to the next."""
FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
"""Of SplitMix64's finaliser."""


def mix(words: U64) -> U64:
    """Finaliser of SplitMix64 [Steele, Lea & Flood 2014]: a bijection that spreads every bit."""
    words = (words ^ (words >> np.uint64(30))) * FACTORS[0]
    words = (words ^ (words >> np.uint64(27))) * FACTORS[1]
    return words ^ (words >> np.uint64(31))
