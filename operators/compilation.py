"""Compilation of functions with numba; machine code is cached on disk where that is possible."""

import logging
import re
import zlib
from collections.abc import Callable, Sequence
from dis import get_instructions
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final, TypeVar, cast

import numpy as np
from numba import njit, typeof, types
from numba.core import cgutils, event
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numba.np.numpy_support import as_struct_dtype

from operators import steps

Function = TypeVar("Function", bound=Callable[..., Any])

log = logging.getLogger("slipflow.compilation")


class _Listener(event.Listener):
    """Listener that logs the first compilation of this process, not the loading of cached code."""

    begun = False

    def on_start(self, event: object) -> None:
        """Log the first compilation."""
        if not self.begun:
            log.info("compiling for this machine: up to some minutes if it is busy, once per kind of flow")
        self.begun = True

    def on_end(self, event: object) -> None:
        """Do nothing; numba calls it."""


_ADDRESS: Final = re.compile(" at 0x[0-9a-f]+")  # differs in each process
_programs: Final = dict[object, Any]()  # of this process; their machine code lives as long as they do

cast("Any", event).register("numba:compile", _Listener())


def compile_function(
    signatures: Any = None, *, nogil: bool = True, **options: Any
) -> Callable[[Function], Function]:
    """Return a decorator that compiles, by default without the GIL; `options` are those of `numba.njit`.

    Without signatures a function is compiled on its first call, else when it is defined. If neither the
    folder of the code nor a cache folder of the user can be written, each process compiles it again.
    """

    def decorate(function: Function) -> Function:
        try:
            result = njit(signatures, cache=True, nogil=nogil, error_model="numpy", **options)(function)
        except (RuntimeError, OSError) as error:  # perhaps the disk is full
            if isinstance(error, RuntimeError) and "no locator available" not in str(error):
                raise
            result = njit(signatures, nogil=nogil, error_model="numpy", **options)(function)
        return cast("Function", result)

    return decorate


def compile_program(
    function: FunctionType, arguments: Sequence[object], known: dict[FunctionType, Any]
) -> Callable[..., Any]:
    """Compile a function, with all functions that it calls, for arguments of the types of these.

    The result skips numba's dispatcher, which inspects the type of each array for 10 us: the caller must
    pass arguments of the same types. Arrays may have any strides. Programs with the same `known` share the
    compiled functions in it.
    """
    signature, names = tuple(_argument_type(each) for each in arguments), dict[FunctionType, str]()
    key = content_name(function, names), signature
    if key not in _programs:
        # else code of other processes in the cache has the same symbols for other types, and is taken for it
        kinds = f"{zlib.crc32(str(signature).encode()):x}"
        names = {each: f"{name}_{kinds}" for each, name in names.items()}
        _programs[key] = compile_function([signature], nogil=False)(_linked(function, names, known))
    compiled = _programs[key]
    return cast("Callable[..., Any]", compiled.overloads[compiled.signatures[0]].entry_point)


def _argument_type(value: object) -> Any:
    if isinstance(value, tuple):
        return cast("Any", types).Tuple([_argument_type(each) for each in value])
    found = cast("Any", typeof)(value)
    return types.Array(found.dtype, found.ndim, "A") if isinstance(value, np.ndarray) else found


def content_name(function: FunctionType, names: dict[FunctionType, str]) -> str:
    """Return the name of a compiled function, the key in the cache: it depends on all that is compiled in."""
    if function not in names:
        text, loaded = _contents(function.__code__)
        read = [_content(function.__globals__.get(key), names, function.__code__.co_names) for key in loaded]
        parts = [function.__module__, text, *loaded, *read]
        names[function] = f"{function.__name__}_{zlib.crc32(repr(parts).encode()):x}"
    return names[function]


def _content(value: object, names: dict[FunctionType, str], members: Sequence[str] = ()) -> str:
    """Return a value that is compiled in as text, with the `members` of a module or an enumeration."""
    if isinstance(helper := getattr(value, "py_func", value), FunctionType):
        return content_name(helper, names)
    if isinstance(value, np.ndarray):  # whose repr is shortened
        return f"{value.dtype} {value.shape} {zlib.crc32(value.tobytes()):x}"
    parts = [getattr(value, name, None) for name in members] if isinstance(value, ModuleType | type) else []
    known = [_content(each, names, members[1:]) for each in parts if not isinstance(each, FunctionType)]
    return _ADDRESS.sub("", repr((value, *known)))


def _linked(
    function: FunctionType, names: dict[FunctionType, str], known: dict[FunctionType, Any]
) -> FunctionType:
    """Return a copy of a function that calls compiled functions."""
    scope = dict(function.__globals__)
    for name in _contents(function.__code__)[1]:
        helper = scope.get(name)
        if helper is steps.copy:
            scope[name] = _copy
        elif isinstance(helper, FunctionType):
            if helper not in known:
                known[helper] = njit(error_model="numpy")(_linked(helper, names, known))
            scope[name] = known[helper]
    result = FunctionType(function.__code__, scope, names[function])
    result.__qualname__ = names[function]
    return result


@cache
def _contents(code: CodeType) -> tuple[str, list[str]]:
    """Return what a function does, as text, and the globals it reads."""
    loaded = {each.argval for each in get_instructions(code) if each.opname == "LOAD_GLOBAL"}
    return repr((code.co_code, code.co_names, code.co_consts)), sorted(loaded)


@intrinsic
def _copy(context: Any, out: Any, row: Any) -> Any:
    """Compile `steps.copy`: the columns that both rows have are their first ones."""
    ours, theirs = (cast("Any", as_struct_dtype(each)).fields for each in (out, row))
    common = len(ours.keys() & theirs.keys())
    columns, same = ([*each.items()][:common] for each in (ours, theirs))
    if columns != same:
        raise TypingError(f"cannot copy: {list(ours)} and {list(theirs)} do not begin with the same columns")
    size = max(offset + kind.itemsize for _, (kind, offset) in columns)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> None:
        pointers = [builder.bitcast(each, cgutils.voidptr_t) for each in arguments]
        count = context.get_constant(types.intp, size)
        cast("Any", cgutils).raw_memcpy(builder, *pointers, count, 1)

    return types.void(out, row), generate
