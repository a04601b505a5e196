"""Loops over the rows of batches: compiled where numba is installed, plain Python elsewhere."""

import math
import zlib
from collections.abc import Callable
from functools import wraps
from types import FunctionType
from typing import Any, TypeAlias, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., Any])
Ints: TypeAlias = tuple[int, ...]


def row_loop(function: Function) -> Function:
    """Compile a loop when it is first called; without numba it runs as Python.

    The functions that it calls are compiled with it. Positional-only parameters are columns of batches: read
    only, in any memory layout. The other arrays are contiguous and may be modified. Compiled or not, the
    result has the same bits, if the arithmetic uses Python's numbers and `math`.
    """
    compiled: list[Callable[..., Any]] = []

    @wraps(function)
    def first(*arguments: object) -> object:
        if not compiled:
            compiled.append(_compiled(cast("FunctionType", function), arguments))
        function.__globals__[function.__name__] = compiled[0]  # later calls find it without a detour
        return compiled[0](*arguments)

    return cast("Function", first)


def nearest_count(value: float) -> int:
    """Return the whole count nearest to a finite value; of two, the greater. Loops may call it.

    >>> nearest_count(-2.5), nearest_count(1e9)
    (-2, 32767)
    """
    return math.floor(min(max(value + 0.5, -32768.0), 32767.0))


def _compiled(function: FunctionType, arguments: tuple[object, ...]) -> Callable[..., Any]:
    try:
        import numba

        from operators.compilation import compile_function
    except ModuleNotFoundError:
        return function
    signature: list[Any] = [cast("Any", numba).typeof(each) for each in arguments]
    for place in range(function.__code__.co_posonlyargcount):
        column = signature[place]
        signature[place] = numba.types.Array(column.dtype, column.ndim, "A", readonly=True)
    # keeps the GIL: a call takes less than another thread may take to give it back
    compiled: Any = compile_function([tuple(signature)], nogil=False)(_with_compiled_helpers(function))
    compiled.__wrapped__ = function
    return cast("Callable[..., Any]", compiled)


def _with_compiled_helpers(function: FunctionType) -> FunctionType:
    """Return a copy that calls compiled helpers; its name, the key of the cache, depends on its constants."""
    from numba import njit

    scope, version = dict(function.__globals__), 0
    for name in function.__code__.co_names:
        helper = scope.get(name)
        if isinstance(helper, FunctionType):
            copy = _with_compiled_helpers(helper)
            code = copy.__code__
            version = zlib.crc32(repr((copy.__name__, code.co_code, code.co_consts)).encode(), version)
            scope[name] = njit(error_model="numpy")(copy)
        elif isinstance(helper, int | float):  # compiled in, perhaps from another file than the cache checks
            version = zlib.crc32(repr((name, helper)).encode(), version)
    name = f"{function.__name__}_{version:x}" if version else function.__name__
    result = FunctionType(function.__code__, scope, name, function.__defaults__)
    result.__qualname__ = name
    return result
