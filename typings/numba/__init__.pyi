"""The part of numba that spinpipe uses; numba itself brings no types."""

from collections.abc import Callable
from typing import Any, Literal

class Dispatcher:
    """A compiled function; it takes positional arguments of any type that numba knows."""

    py_func: Callable[..., Any]
    def __call__(self, *args: Any) -> Any: ...

def typeof(val: object) -> object: ...
def njit(
    *,
    cache: bool = ...,
    nogil: bool = ...,
    inline: Literal["never", "always"] = ...,
    forceinline: bool = ...,
    error_model: Literal["python", "numpy"] = ...,
    fastmath: bool | set[str] = ...,
    no_cpython_wrapper: bool = ...,
    no_cfunc_wrapper: bool = ...,
) -> Callable[[Callable[..., Any]], Dispatcher]: ...
