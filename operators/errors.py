"""The errors that slipflow raises: few, typed, carrying the data they are about."""

import errno
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

_RIGHTS: Final = "give this user the right to it"
_ROOM: Final = "make room there, or name another place"
_FILE: Final = "a file has a name that must be a folder's"
_WAY: Final = "is the cable in, and is this its address?"
_REMEDIES: Final[Mapping[int | None, str]] = MappingProxyType(
    {
        errno.EACCES: _RIGHTS,
        errno.EPERM: _RIGHTS,
        errno.EROFS: "name a place that can be written to",
        errno.ENOSPC: _ROOM,
        errno.EDQUOT: _ROOM,
        errno.EFBIG: _ROOM,
        errno.EEXIST: _FILE,
        errno.ENOTDIR: _FILE,
        errno.EISDIR: "a folder has a name that must be a file's",
        errno.EIO: "the disk fails: the system's log says more",
        errno.EMFILE: "allow more open files, as with ulimit -n",
        errno.EADDRINUSE: "stop the program that uses it, or give another port",
        errno.EADDRNOTAVAIL: "this machine has no such address: give one that it has",
        errno.ECONNREFUSED: "is it on, and are this its address and port?",
        errno.EHOSTUNREACH: _WAY,
        errno.ENETUNREACH: _WAY,
    }
)


class SlipflowError(Exception):
    """Base of every error that a user can cause and mend; its text is one line."""

    def __reduce__(self) -> tuple[type["SlipflowError"], tuple[object, ...]]:
        """Made anew from what it carries, in the order of its arguments: errors travel between processes."""
        return type(self), tuple(vars(self).values()) or self.args


class ParameterError(SlipflowError):
    """A parameter has a value that its owner cannot work with.

    >>> raise ParameterError("Debounce", "consecutive", 0, "at least 1")
    Traceback (most recent call last):
    operators.errors.ParameterError: Debounce: consecutive is 0, must be at least 1
    """

    def __init__(self, owner: str, name: str, value: object, must_be: str) -> None:
        super().__init__(f"{owner}: {name} is {value!r}, must be {must_be}")
        self.owner, self.name, self.value, self.must_be = owner, name, value, must_be


class BatchError(SlipflowError):
    """A batch breaks the contract of its type."""

    def __init__(self, kind: str, column: str, reason: str) -> None:
        super().__init__(f"{kind}.{column}: {reason}")
        self.kind, self.column, self.reason = kind, column, reason


class FlowError(SlipflowError):
    """A flow is wired wrongly; `edge` names the place, as in ``touch -> Label``."""

    def __init__(self, flow: str, edge: str, reason: str) -> None:
        super().__init__(f"flow {flow!r}: {edge}: {reason}")
        self.flow, self.edge, self.reason = flow, edge, reason


class OperatorError(SlipflowError):
    """An operator failed, or broke its contract, while the flow ran."""

    def __init__(self, flow: str, operator: str, reason: str) -> None:
        super().__init__(f"flow {flow!r}: {operator}: {reason}")
        self.flow, self.operator, self.reason = flow, operator, reason


class InputError(SlipflowError):
    """Something that was to be read cannot be; `where` names the file, and the line or column if known."""

    def __init__(self, where: str, reason: str) -> None:
        super().__init__(f"{where}: {reason}")
        self.where, self.reason = where, reason


class EndpointError(SlipflowError):
    """A connector cannot reach or write to its place; a runner tries a source or sink again."""

    def __init__(self, place: str, reason: str) -> None:
        super().__init__(f"{place}: {reason}")
        self.place, self.reason = place, reason


def because(error: OSError) -> str:
    """Why the system did not do what it was asked, and what to do about it where that is known.

    >>> because(OSError(errno.ENOSPC, "No space left on device"))
    'No space left on device; make room there, or name another place'
    """
    reason = error.strerror or str(error) or type(error).__name__
    if error.errno == errno.EEXIST and error.filename is not None:
        reason = f"{reason}, {error.filename}"
    remedy = _REMEDIES.get(error.errno)
    return f"{reason}; {remedy}" if remedy else reason
