"""Compilation of functions with numba; machine code is cached on disk where that is possible."""

import logging
from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit
from numba.core import event

Function = TypeVar("Function", bound=Callable[..., Any])

log = logging.getLogger("slipflow.compilation")


class _Announcer(event.Listener):
    """Listener that logs the compilations of this process; loading cached code is not logged."""

    compiled = begun = 0  # functions

    def on_start(self, event: object) -> None:
        """Log the first compilation."""
        if not self.begun:
            log.info("compiling for this machine: up to a minute, once; later runs load the result")
        self.begun += 1

    def on_end(self, event: object) -> None:
        """Log every tenth compilation."""
        self.compiled += 1
        if self.compiled % 10 == 0:
            log.info("compiling: %d functions are ready", self.compiled)


cast("Any", event).register("numba:compile", _Announcer())


def compile_function(
    signatures: Any = None,
    *,
    nogil: bool = True,
    **options: Any,
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
