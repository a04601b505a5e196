"""Compilation of functions with numba; machine code is cached on disk where that is possible."""

import logging
from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit
from numba.core import event

Function = TypeVar("Function", bound=Callable[..., Any])

log = logging.getLogger("slipflow.compilation")


class _Announcer(event.Listener):
    """Listener that logs when this process compiles for the first time; loading cached code is not logged."""

    announced = False

    def on_start(self, event: object) -> None:  # noqa: ARG002 - numba's signature
        """Log the first compilation."""
        if not self.announced:
            self.announced = True
            log.info("compiling for this machine; this takes some seconds, and later runs load the result")

    def on_end(self, event: object) -> None:
        """Log nothing."""


cast("Any", event).register("numba:compile", _Announcer())


def compile_function(
    signatures: Any = None,  # noqa: ANN401 - numba's
    *,
    nogil: bool = True,
    **options: Any,  # noqa: ANN401 - numba's
) -> Callable[[Function], Function]:
    """Return a decorator that compiles, by default without the GIL; `options` are those of `numba.njit`.

    Without signatures a function is compiled on its first call, else when it is defined. If neither the
    folder of the code nor a cache folder of the user can be written, each process compiles it again.
    """

    def decorate(function: Function) -> Function:
        try:
            result = njit(signatures, cache=True, nogil=nogil, error_model="numpy", **options)(function)
        except RuntimeError as error:
            if "no locator available" not in str(error):
                raise
            result = njit(signatures, nogil=nogil, error_model="numpy", **options)(function)
        return cast("Function", result)

    return decorate
