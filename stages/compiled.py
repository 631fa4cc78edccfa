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


def sources(*modules: str) -> str:
    """Digest of the sources of modules beside this one, and of this one."""
    texts = [Path(__file__).with_name(f"{name}.py").read_bytes() for name in (*modules, "compiled")]
    return hashlib.sha256(b"".join(texts)).hexdigest()
