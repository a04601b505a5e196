"""Compilation of functions with numba; machine code is cached on disk where that is possible."""

import logging
import re
import zlib
from collections.abc import Callable, Iterator, Sequence
from dis import get_instructions
from enum import Enum, EnumType
from functools import cache
from traceback import walk_tb
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final, TypeVar, cast

import numpy as np
from numba import njit, typeof, types
from numba.core import cgutils, event
from numba.core.errors import TypingError
from numba.extending import intrinsic
from numba.np.numpy_support import as_struct_dtype

from operators import steps
from operators.errors import InputError

Function = TypeVar("Function", bound=Callable[..., Any])

log = logging.getLogger("slipflow.compilation")


class _Listener(event.Listener):
    """Listener that logs the first compilation of this process, not the loading of cached code."""

    begun = False
    failed: Final = list[tuple[CodeType, Exception]]()  # in the current program, the innermost first

    def on_start(self, event: object) -> None:
        """Log the first compilation."""
        if not self.begun:
            log.info("compiling for this machine: up to some minutes if it is busy, once per kind of flow")
        self.begun = True

    def on_end(self, event: Any) -> None:
        """Keep the error of a function."""
        if details := event._exc_details:  # noqa: SLF001 - `is_failed` returns the opposite
            self.failed.append((event.data["dispatcher"].py_func.__code__, details[1]))


_NOISE: Final = re.compile(r"\x1b\[\d*m|\(\[.*\], \d+, True\)")  # colours; fields of records
_ADDRESS: Final = re.compile(" at 0x[0-9a-f]+")  # differs in each process
_LIBRARIES: Final = {"math", "numba", "numpy"}  # modules whose contents stay the same
_programs: Final = dict[object, Any]()  # of this process; their machine code lives as long as they do

cast("Any", event).register("numba:compile", _listener := _Listener())


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

    Raises:
        InputError: if a function cannot be compiled, with its line.
    """
    signature, names = tuple(_argument_type(each) for each in arguments), dict[FunctionType, str]()
    key = content_name(function, names), signature
    if key not in _programs:
        # else code of other processes in the cache has the same symbols for other types, and is taken for it
        kinds = f"{zlib.crc32(str(signature).encode()):x}"
        names = {each: f"{name}_{kinds}" for each, name in names.items()}
        _listener.failed.clear()
        try:
            _programs[key] = compile_function([signature], nogil=False)(_linked(function, names, known))
        except Exception as error:
            raise _explained(names, error) from error
    compiled = _programs[key]
    return cast("Callable[..., Any]", compiled.overloads[compiled.signatures[0]].entry_point)


def _explained(names: dict[FunctionType, str], error: Exception) -> InputError:
    """Return what is wrong in the innermost function of an operator that could not be compiled."""
    ordered = sorted(names, key=_is_of_user)  # those of users last
    codes = [each.__code__ for each in ordered if each.__module__ != "operators.program"]
    code, error = next((each for each in _listener.failed if each[0] in codes), (codes[-1], error))
    text = _NOISE.sub("", str(error))
    reason = re.search("cannot copy: .+", text) or re.search(r"(?m)^(?!Failed in )\S.*", text) or [""]
    frames = (frame.f_locals.get("loc") for frame, _ in walk_tb(error.__traceback__))  # of numba
    places = " ".join(map(str, (getattr(error, "loc", ""), error, *frames)))
    line = re.search(rf"{re.escape(code.co_filename)} \((\d+)\)", places)
    where = f"{code.co_filename}:{line[1] if line else code.co_firstlineno}"
    return InputError(where, f"{code.co_name} cannot be compiled: {type(error).__name__}: {reason[0]}")


def _argument_type(value: object) -> Any:
    if isinstance(value, tuple):
        return cast("Any", types).Tuple([_argument_type(each) for each in value])
    found = cast("Any", typeof)(value)
    return types.Array(found.dtype, found.ndim, "A") if isinstance(value, np.ndarray) else found


def content_name(function: FunctionType, names: dict[FunctionType, str]) -> str:
    """Return the name of a compiled function, the key in the cache: it depends on all that is compiled in.

    Raises:
        InputError: if the function cannot be compiled: it reads variables of another one, or calls itself.
    """
    if names.get(function) == "":
        where = f"{function.__code__.co_filename}:{function.__code__.co_firstlineno}"
        raise InputError(where, f"{function.__name__} calls itself: use a loop")
    if function not in names:
        names[function] = ""  # until its name is known
        if function.__code__.co_freevars:
            where = f"{function.__code__.co_filename}:{function.__code__.co_firstlineno}"
            reason = f"{function.__name__} reads variables of the function around it: use settings"
            raise InputError(where, reason)
        text, loaded, read = _contents(function.__code__)
        values = [function.__defaults__, function.__kwdefaults__, *map(function.__globals__.get, loaded)]
        # code in the cache imports its modules: they may be renamed
        parts = [function.__module__, text, *loaded, *(_content(each, read, names) for each in values)]
        parts += ["as in Python"] if _is_of_user(function) else []
        del names[function]  # it comes after those that it calls
        names[function] = f"{function.__name__}_{zlib.crc32(repr(parts).encode()):x}"
    return names[function]


def _content(value: object, read: Sequence[str], names: dict[FunctionType, str]) -> str:
    """Return a value that is compiled in as text; of a module, the attributes that a function may `read`."""
    if isinstance(helper := getattr(value, "py_func", value), FunctionType):
        return content_name(helper, names)
    if isinstance(value, ModuleType):  # perhaps of another file, whose changes numba does not notice
        value = _attributes(value, read)
    elif isinstance(value, EnumType):
        value = dict(value.__members__)
    if isinstance(value, dict):
        return repr([(key, _content(each, read, names)) for key, each in value.items()])
    if isinstance(value, tuple):
        return repr((type(value), [_content(each, read, names) for each in value]))
    if isinstance(value, np.ndarray):
        return repr((value.dtype, value.shape, value.tobytes()))
    return _ADDRESS.sub("", repr((type(value), value.value) if isinstance(value, Enum) else value))


def _attributes(module: ModuleType, read: Sequence[str]) -> dict[str, object]:
    """Return the attributes with these names of a module, and of the modules among them, by their paths."""
    modules, found = [module], dict[str, object]()
    for each in modules:  # which grows
        found[each.__name__] = None
        for name in read if each.__name__.partition(".")[0] not in _LIBRARIES else ():
            value = getattr(each, name, None)
            if not isinstance(value, ModuleType):
                found[f"{each.__name__}.{name}"] = value
            elif value not in modules:
                modules.append(value)
    return found


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
                linked, checked = _linked(helper, names, known), _is_of_user(helper)
                compiled = njit(error_model="python" if checked else "numpy", boundscheck=checked)
                known[helper] = compiled(linked)
            scope[name] = known[helper]
    result = FunctionType(function.__code__, scope, names[function], function.__defaults__)
    result.__qualname__, result.__kwdefaults__ = names[function], function.__kwdefaults__
    return result


def _is_of_user(function: FunctionType) -> bool:
    """Return True for a function of users: errors are division by zero, and an index out of range."""
    return not str(function.__module__).startswith("operators.")


@cache
def _contents(code: CodeType) -> tuple[str, list[str], list[str]]:
    """Return what a function with its comprehensions does, as text, and the globals and names it reads."""
    codes = list(_codes(code))
    plain = [[each for each in part.co_consts if not isinstance(each, CodeType)] for part in codes]
    text = repr([(part.co_code, part.co_names, kept) for part, kept in zip(codes, plain, strict=True)])
    loads = (each for part in codes for each in get_instructions(part) if each.opname == "LOAD_GLOBAL")
    names = {each for part in codes for each in (*part.co_names, *part.co_consts) if isinstance(each, str)}
    return text, sorted({each.argval for each in loads}), sorted(names)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Return the code of a function, and of comprehensions in it."""
    yield code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from _codes(each)


@intrinsic
def _copy(context: Any, out: Any, row: Any) -> Any:
    """Compile `steps.copy`: the columns of the shorter row lie at the same place in both."""
    ours, theirs = (cast("Any", as_struct_dtype(each)).fields for each in (out, row))
    shorter, longer = sorted((ours, theirs), key=len)
    if any(longer.get(name) != each for name, each in shorter.items()):
        raise TypingError(f"cannot copy: {list(longer)} does not begin with the columns {list(shorter)}")
    size = max(offset + kind.itemsize for kind, offset in shorter.values())

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> None:
        pointers = [builder.bitcast(each, cgutils.voidptr_t) for each in arguments]
        count = context.get_constant(types.intp, size)
        cast("Any", cgutils).raw_memcpy(builder, *pointers, count, 1)

    return types.void(out, row), generate
