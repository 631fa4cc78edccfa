"""How kernels are compiled, and what keys those of them that are kept on disk.

Only the outermost kernels are cached. Numba's cache looks at the file of the outermost one alone,
so it encloses a digest of the sources of all kernels it is made of: a change to any compiles anew.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from numba import njit

inner = njit(
    nogil=True,
    error_model="numpy",
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
)
"""Compiles what only other kernels call."""

inlined = njit(
    nogil=True,
    error_model="numpy",
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
    forceinline=True,
)
"""The same for what is called at every origin."""


def sources(folder: str) -> str:
    """Digest of the sources of all kernels below a folder beside this file, and of this file."""
    here = Path(__file__)
    files = [here, *sorted((here.parent / folder).rglob("*.py"))]
    texts = [file.read_bytes() for file in files]
    kernels = [text for text in texts if b"stages.compiled import" in text or text is texts[0]]
    return hashlib.sha256(b"".join(kernels)).hexdigest()
