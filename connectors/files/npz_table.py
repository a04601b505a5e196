"""Reader of .npz files: declared shapes are checked against the sizes of their data; nothing is unpickled."""

import hashlib
import io
import tokenize
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from connectors.files import trace_table
from connectors.files.csv_table import read_bytes
from connectors.files.trace_table import TraceTable
from operators.errors import InputError

WIDTH_LIMIT: Final = 4096  # columns of an array

_HEADERS: Final = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_npz(path: Path) -> TraceTable:
    """Read a .npz file.

    Arrays (n,) become columns; arrays (n, k) become columns ``name0``, ``name1``, ..., structured arrays
    ``name.field``. The rows are those of most arrays; others are left out.

    Raises:
        InputError: if it cannot be read, is damaged or too large.
    """
    where, content = str(path), read_bytes(path)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            size = sum(info.file_size for info in archive.infolist())
            if size > trace_table.LIMIT:
                limit = f"unpacks to more than {trace_table.LIMIT >> 20} MiB, the limit"
                raise InputError(where, f"{limit}: split its arrays into several files")
            arrays = {info.filename.removesuffix(".npy"): _read(archive, info) for info in archive.infolist()}
    except (
        ValueError,
        OSError,
        RuntimeError,
        EOFError,
        LookupError,
        SyntaxError,  # this and the next two: of a header that is not Python
        TypeError,
        tokenize.TokenError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(where, f"is damaged or not a .npz file: {reason:.200}; restore a copy") from None
    left_out = {name: array for name, array in arrays.items() if isinstance(array, str)}
    flat = dict[str, NDArray[Any]]()
    for name, array in arrays.items():
        if not isinstance(array, str):
            for column, values in _columns(name, array, left_out):
                flat[column] = values
    lengths = Counter(len(array) for array in arrays.values() if not isinstance(array, str) and array.ndim)
    rows = max(lengths, key=lambda length: (lengths[length], length), default=0)
    for name, values in flat.items():
        if len(values) != rows:
            left_out[name] = f"it has {len(values)} rows, most arrays have {rows}"
    columns = {name: values for name, values in flat.items() if name not in left_out}
    if not columns:
        listed = "; ".join(f"{name}: {reason}" for name, reason in left_out.items())
        raise InputError(where, f"has no array of numbers or texts ({listed:.200})")
    return TraceTable(columns, where, sha256=hashlib.sha256(content).hexdigest(), left_out=left_out)


def _read(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any] | str:
    """Return an array, or the reason why it cannot be used."""
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        if version not in _HEADERS:
            return f"its format {version} is not supported"
        shape, columnwise, dtype = _header(file, version)
        if dtype.hasobject:
            return "it holds Python objects: save it as numbers"
        if prod(shape) * dtype.itemsize != info.file_size - file.tell() or min(shape, default=0) < 0:
            raise ValueError(f"array {info.filename} does not have the size that its header declares")
        values = np.frombuffer(file.read(), dtype) if dtype.itemsize else np.empty(0)
    return values.reshape(shape, order="F" if columnwise else "C")


def _header(file: IO[bytes], version: tuple[int, int]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    return _HEADERS[version](file)


def _columns(name: str, array: NDArray[Any], left_out: dict[str, str]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the columns (n,) of an array."""
    if array.dtype.names:
        for each in array.dtype.names:
            yield from _columns(f"{name}.{each}", array[each], left_out)
        return
    width = prod(array.shape[1:])
    if array.ndim == 0:
        left_out[name] = "it is a single value"
    elif array.dtype.kind not in "biufUM":
        left_out[name] = f"its values are {array.dtype}"
    elif array.ndim == 1:
        yield name, array
    elif width > WIDTH_LIMIT:
        left_out[name] = f"it has {width} columns, {WIDTH_LIMIT} at most"
    else:
        flat = array.reshape(len(array), width)
        yield from ((f"{name}{column}", flat[:, column]) for column in range(width))
