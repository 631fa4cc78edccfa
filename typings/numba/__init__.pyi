"""The part of numba that spinpipe uses; numba itself brings no types."""

from collections.abc import Callable
from typing import Any, Literal, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

prange = range

def njit(
    *,
    cache: bool = ...,
    nogil: bool = ...,
    parallel: bool = ...,
    inline: Literal["never", "always"] = ...,
    error_model: Literal["python", "numpy"] = ...,
    boundscheck: bool = ...,
    no_cpython_wrapper: bool = ...,
    no_cfunc_wrapper: bool = ...,
) -> Callable[[F], Callable[..., Any]]: ...
