"""Results of work units, kept on the shared storage until their session is complete.

A result's file name follows from its unit, and its bytes follow from the recording and the flow. A unit that
is processed again, after a failure or by another worker, writes the same bytes to the same file.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, Final, TypeAlias, cast
from uuid import uuid4
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from operators.batch import Batch, columns
from operators.errors import EndpointError, InputError, os_error_reason
from storage import files

UnitResult: TypeAlias = dict[tuple[int, int, int], Batch]  # by slice, operator's index in the flow, fingertip

_LIMIT: Final = 1024 * files.MiB  # of a file
_INDEX: Final = "index"  # (n, 4) slice, operator, fingertip and rows of each batch


def write_result(path: Path, result: UnitResult) -> None:
    """Write a result atomically and durably.

    Raises:
        EndpointError: if it cannot be written.
    """
    index = np.array([(*key, len(batch)) for key, batch in result.items()], np.int64).reshape(-1, 4)
    arrays: dict[str, NDArray[Any]] = {_INDEX: index}
    for operator in sorted({operator for _, operator, _ in result}):
        batches = [batch for (_, each, _), batch in result.items() if each == operator]
        for name in columns(type(batches[0])):
            arrays[f"{operator}.{name}"] = np.concatenate([getattr(batch, name) for batch in batches])
    data = BytesIO()
    cast("Any", np.savez)(data, **arrays)
    scratch = path.with_name(f"{path.name}.{uuid4().hex}{files.SCRATCH}")  # two workers may write one result
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch.open("xb") as file:
            file.write(data.getbuffer())
            file.flush()
            os.fsync(file.fileno())
        scratch.replace(path)
        files.sync(path.parent)
    except OSError as error:
        with suppress(OSError):
            scratch.unlink(missing_ok=True)
        raise EndpointError(str(path), f"cannot be written: {os_error_reason(error)}") from error


def read_result(path: Path, kinds: Mapping[int, type[Batch]]) -> UnitResult:
    """Read the result of a unit.

    Args:
        path: File of the result.
        kinds: Batch types of the operators, by their index in the flow.

    Raises:
        InputError: if the file is missing or damaged.
    """
    try:
        with np.load(BytesIO(files.read(path, _LIMIT)), allow_pickle=False) as loaded:
            arrays: dict[str, NDArray[Any]] = {name: loaded[name] for name in loaded.files}
        result, begin = UnitResult(), dict.fromkeys(kinds, 0)
        for number, operator, finger, rows in arrays[_INDEX].tolist():
            kind, start = kinds[operator], begin[operator]
            begin[operator] = stop = start + rows
            values = [arrays[f"{operator}.{name}"][start:stop] for name in columns(kind)]
            result[number, operator, finger] = kind(*values, finger=finger).check()
    except (ValueError, LookupError, TypeError, OSError, EOFError, BadZipFile) as error:
        raise InputError(str(path), f"is damaged: {error}") from error
    return result


def read_results(folder: Path, units: int, kinds: Mapping[int, type[Batch]]) -> Iterator[UnitResult]:
    """Yield the results of a share's `units` units in order.

    Raises:
        InputError: if a file is missing or damaged.
    """
    for number in range(units):
        yield read_result(folder / result_file(number), kinds)


def result_file(number: int) -> str:
    """Return the file name of a unit's result.

    >>> result_file(7)
    '000007.npz'
    """
    return f"{number:06d}.npz"
