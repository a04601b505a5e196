"""What workers have worked out, on the shared storage, until a session is whole.

The file of a claim is named by what the claim is about, and its bytes follow from the recording and the flow
alone: work that is done again, after a failure or by a worker that was given up, writes the same bytes to the
same name. So it does not matter how often a claim is worked off.
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

Given: TypeAlias = dict[tuple[int, int, int], Batch]  # by slice, operator's place among the nodes, fingertip

_LIMIT: Final = 1024 * files.MiB  # of a file
_INDEX: Final = "index"  # (n, 4) of each batch: slice, operator, fingertip, rows


def stage(path: Path, given: Given) -> None:
    """Write what a claim came to, whole or not at all; it survives a power cut.

    Raises:
        EndpointError: if it cannot be written.
    """
    index = np.array([(*place, len(batch)) for place, batch in given.items()], np.int64).reshape(-1, 4)
    arrays: dict[str, NDArray[Any]] = {_INDEX: index}
    for operator in sorted({operator for _, operator, _ in given}):
        batches = [batch for (_, each, _), batch in given.items() if each == operator]
        for name in columns(type(batches[0])):
            arrays[f"{operator}.{name}"] = np.concatenate([getattr(batch, name) for batch in batches])
    data = BytesIO()
    cast("Any", np.savez)(data, **arrays)
    scratch = path.with_name(f"{path.name}.{uuid4().hex}{files.SCRATCH}")  # another worker may do the same
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


def staged(path: Path, kinds: Mapping[int, type[Batch]]) -> Given:
    """What a claim came to.

    Args:
        path: Its file.
        kinds: What the operators give, by their places among the flow's nodes.

    Raises:
        InputError: if the file is missing or damaged.
    """
    try:
        with np.load(BytesIO(files.read(path, _LIMIT)), allow_pickle=False) as held:
            arrays: dict[str, NDArray[Any]] = {name: held[name] for name in held.files}
        given, begin = Given(), dict.fromkeys(kinds, 0)
        for number, operator, finger, rows in arrays[_INDEX].tolist():
            kind, start = kinds[operator], begin[operator]
            begin[operator] = stop = start + rows
            own = [arrays[f"{operator}.{name}"][start:stop] for name in columns(kind)]
            given[number, operator, finger] = kind(*own, finger=finger).check()
    except (ValueError, LookupError, TypeError, OSError, EOFError, BadZipFile) as error:
        raise InputError(str(path), f"is damaged: {error}") from error
    return given


def staged_in(folder: Path, claims: int, kinds: Mapping[int, type[Batch]]) -> Iterator[Given]:
    """What the claims of a share came to, in their order; there are as many as `claims`.

    Raises:
        InputError: as `staged`.
    """
    for number in range(claims):
        yield staged(folder / staged_name(number), kinds)


def staged_name(number: int) -> str:
    """The file of a claim, by its number.

    >>> staged_name(7)
    '000007.npz'
    """
    return f"{number:06d}.npz"
