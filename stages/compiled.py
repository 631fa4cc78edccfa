"""How kernels are compiled, and what keys those of them that are kept on disk.

Only the outermost kernels are kept. Numba looks at the file of the outermost one alone, so its name
holds a digest of the sources of all kernels it is made of: a change to any compiles anew, and what
an earlier version kept, of types that may be gone, is not even read.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

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


def kept(folder: str) -> Callable[[Callable[..., Any]], Any]:
    """Compiles an outermost kernel of a folder beside this file, and keeps it on disk."""
    digest = sources(folder)[:16]

    def compiled(kernel: Callable[..., Any]) -> Any:
        kernel.__qualname__ += f"_{digest}"
        return njit(cache=True, nogil=True, error_model="numpy")(kernel)

    return compiled


def sources(folder: str) -> str:
    """Digest of the sources of all kernels below a folder beside this file, and of this file."""
    here = Path(__file__)
    files = [here, *sorted((here.parent / folder).rglob("*.py"))]
    texts = [file.read_bytes() for file in files]
    kernels = [text for text in texts if b"stages.compiled import" in text or text is texts[0]]
    return hashlib.sha256(b"".join(kernels)).hexdigest()
