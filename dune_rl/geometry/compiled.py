"""Functions that numba compiles, for loops that arrays of numpy cannot do in a few calls."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


def compile_function(function: FunctionT) -> FunctionT:
    """`function`, compiled when first called, and kept for later processes where a folder can be written."""
    try:
        return cast(FunctionT, njit(cache=True, nogil=True)(function))
    except RuntimeError:
        return cast(FunctionT, njit(nogil=True)(function))
