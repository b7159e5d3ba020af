"""Functions that numba compiles, for loops that arrays of numpy cannot do in a few calls."""

import hashlib
from collections.abc import Callable
from contextlib import suppress
from types import CodeType, FunctionType
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

FunctionT = TypeVar("FunctionT", bound=Callable[..., Any])


def compile_function(function: FunctionT) -> FunctionT:
    """`function`, compiled when first called, and kept for later processes where a folder can be written."""
    compiled: Any = njit(nogil=True)(function)
    with suppress(RuntimeError):
        compiled._cache = _Cache(function)
    return cast(FunctionT, compiled)


class _Cache(FunctionCache):
    """Compiled code of a function, which is not used when a function or constant that it names has changed.

    Numba's own looks at the file of the function alone, though it compiles in those that are called.
    """

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        digest = hashlib.sha256(repr(_meaning(self._py_func, ())).encode()).hexdigest()
        return (*super()._index_key(sig, codegen), digest)


def _meaning(function: FunctionType, callers: tuple[FunctionType, ...]) -> tuple[Any, ...]:
    """What a function does: its code, and the values and compiled functions of its module that it names."""
    code = function.__code__
    named = [function.__globals__.get(name) for name in code.co_names]
    called = [
        _meaning(one.py_func, (*callers, function))
        for one in named
        if isinstance(one, Dispatcher) and one.py_func not in callers
    ]
    values = [one for one in named if isinstance(one, bool | int | float | str | tuple | np.generic)]
    return _instructions(code), values, called


def _instructions(code: CodeType) -> tuple[Any, ...]:
    constants = [_instructions(one) if isinstance(one, CodeType) else one for one in code.co_consts]
    return code.co_code, constants
