"""Errors that slipflow raises: few types, each with the data of the failure as attributes."""

import errno
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

_PERMISSION: Final = "grant this user permission"
_SPACE: Final = "free some space, or use another location"
_FILE_FOUND: Final = "a file exists where a folder is needed"
_NETWORK: Final = "check the cable and the address"
_REMEDIES: Final[Mapping[int | None, str]] = MappingProxyType(
    {
        errno.EACCES: _PERMISSION,
        errno.EPERM: _PERMISSION,
        errno.EROFS: "use a writable location",
        errno.ENOSPC: _SPACE,
        errno.EDQUOT: _SPACE,
        errno.EFBIG: _SPACE,
        errno.EEXIST: _FILE_FOUND,
        errno.ENOTDIR: _FILE_FOUND,
        errno.EISDIR: "a folder exists where a file is needed",
        errno.EIO: "the disk is failing: see the system log",
        errno.EMFILE: "raise the limit on open files, for example with ulimit -n",
        errno.EADDRINUSE: "stop the program that uses this port, or choose another port",
        errno.EADDRNOTAVAIL: "use an address of this machine",
        errno.ECONNREFUSED: "check that the device is on, its address and its port",
        errno.EHOSTUNREACH: _NETWORK,
        errno.ENETUNREACH: _NETWORK,
    }
)


class SlipflowError(Exception):
    """Base of all errors that a user can cause and fix; the message is one line."""

    def __reduce__(self) -> tuple[type["SlipflowError"], tuple[object, ...], dict[str, object]]:
        """Pickle the attributes, in the order of the arguments, so that processes can exchange errors."""
        arguments = [value for name, value in vars(self).items() if name != "__notes__"]
        return type(self), tuple(arguments) or self.args, vars(self)


class ParameterError(SlipflowError):
    """Invalid value of a parameter.

    >>> raise ParameterError("Debounce", "consecutive", 0, "at least 1")
    Traceback (most recent call last):
    operators.errors.ParameterError: Debounce: consecutive is 0, must be at least 1
    """

    def __init__(self, owner: str, name: str, value: object, must_be: str) -> None:
        super().__init__(f"{owner}: {name} is {value!r:.300}, must be {must_be}")
        self.owner, self.name, self.value, self.must_be = owner, name, value, must_be


class BatchError(SlipflowError):
    """Batch that violates the contract of its type."""

    def __init__(self, kind: str, column: str, reason: str) -> None:
        super().__init__(f"{kind}.{column}: {reason}")
        self.kind, self.column, self.reason = kind, column, reason


class FlowError(SlipflowError):
    """Wrong wiring of a flow; `edge` names the location, as in ``touch -> Label``."""

    def __init__(self, flow: str, edge: str, reason: str) -> None:
        super().__init__(f"flow {flow!r}: {edge}: {reason}")
        self.flow, self.edge, self.reason = flow, edge, reason


class FingertipError(SlipflowError):
    """Data of a fingertip that a detector was not made for; `fix` names the operators that convert it.

    >>> raise FingertipError("tcn", "100 Hz", "1000 Hz", "use Resample(rate=100)")
    Traceback (most recent call last):
    operators.errors.FingertipError: tcn needs 100 Hz; the data has 1000 Hz: use Resample(rate=100)
    """

    def __init__(self, owner: str, needs: str, has: str, fix: str) -> None:
        super().__init__(f"{owner} needs {needs}; the data has {has}: {fix}")
        self.owner, self.needs, self.has, self.fix = owner, needs, has, fix


class OperatorError(SlipflowError):
    """Failure of an operator, or a breach of its contract, while the flow runs."""

    def __init__(self, flow: str, operator: str, reason: str) -> None:
        super().__init__(f"flow {flow!r}: {operator}: {reason}")
        self.flow, self.operator, self.reason = flow, operator, reason


class InputError(SlipflowError):
    """Unreadable or invalid input; `where` names the file, and the line or column if known."""

    def __init__(self, where: str, reason: str) -> None:
        super().__init__(f"{where}: {reason}")
        self.where, self.reason = where, reason


class EndpointError(SlipflowError):
    """Failed access of a connector to a device, server or file; a runner retries sources and sinks."""

    def __init__(self, endpoint: str, reason: str) -> None:
        super().__init__(f"{endpoint}: {reason}")
        self.endpoint, self.reason = endpoint, reason


class OutputClosedError(EndpointError):
    """Output whose reader has gone, as in ``slipflow run ... | head``: the run ends quietly."""


def os_error_reason(error: OSError, *, of_device: bool = False) -> str:
    """Return the system's reason for an error of a file or a device, and the remedy where one is known.

    >>> os_error_reason(OSError(errno.ENOSPC, "No space left on device"))
    'No space left on device; free some space, or use another location'
    """
    reason = error.strerror or str(error) or type(error).__name__
    if error.errno == errno.EEXIST and error.filename is not None:
        reason = f"{reason}, {error.filename}"
    remedy = _REMEDIES.get(error.errno)
    if of_device and error.errno == errno.EIO:
        remedy = "check the cable and the power"
    return f"{reason}; {remedy}" if remedy else reason
