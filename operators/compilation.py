"""Compilation of functions with numba; machine code is cached on disk where that is possible."""

import zlib
from collections.abc import Callable
from functools import wraps
from types import FunctionType
from typing import Any, TypeVar, cast

import numpy as np

Function = TypeVar("Function", bound=Callable[..., Any])


def compile_function(signatures: Any = None, **options: Any) -> Callable[[Function], Function]:  # noqa: ANN401 - numba's
    """Return a decorator that compiles without the GIL; `options` are those of `numba.njit`.

    Without signatures a function is compiled on its first call, else when it is defined. If neither the
    folder of the code nor a cache folder of the user can be written, each process compiles it again.
    """
    from numba import njit  # noqa: PLC0415 - takes 0.4 s to import

    def decorate(function: Function) -> Function:
        try:
            result = njit(signatures, cache=True, nogil=True, error_model="numpy", **options)(function)
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            result = njit(signatures, nogil=True, error_model="numpy", **options)(function)
        return cast("Function", result)

    return decorate


def row_loop(function: Function) -> Function:
    """Compile a loop over rows when it is first called; without numba it runs as Python.

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


def _compiled(function: FunctionType, arguments: tuple[object, ...]) -> Callable[..., Any]:
    try:
        from numba import typeof, types  # noqa: PLC0415 - takes 0.4 s to import
    except ModuleNotFoundError:
        return function
    columns = function.__code__.co_posonlyargcount
    signature = tuple(
        types.Array(found.dtype, found.ndim, "A", readonly=True)
        if place < columns and isinstance(each, np.ndarray)
        else found
        for place, (each, found) in enumerate(
            zip(arguments, map(cast("Any", typeof), arguments), strict=True)
        )
    )
    compiled: Any = compile_function([signature])(_with_compiled_helpers(function))
    compiled.__wrapped__ = function
    return cast("Callable[..., Any]", compiled)


def _with_compiled_helpers(function: FunctionType) -> FunctionType:
    """Return a copy that calls compiled helpers; its name, the key of the cache, changes with them."""
    from numba import njit  # noqa: PLC0415 - takes 0.4 s to import

    scope, version = dict(function.__globals__), 0
    for name in function.__code__.co_names:
        helper = scope.get(name)
        if isinstance(helper, FunctionType):
            copy = _with_compiled_helpers(helper)
            code = copy.__code__
            version = zlib.crc32(repr((copy.__name__, code.co_code, code.co_consts)).encode(), version)
            scope[name] = njit(error_model="numpy")(copy)
    name = f"{function.__name__}_{version:x}" if version else function.__name__
    result = FunctionType(function.__code__, scope, name, function.__defaults__)
    result.__qualname__ = name
    return result
