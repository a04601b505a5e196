"""The steps at which a recording, or its recovery, can be cut off: each leaves something that can be read.

A test puts a function in place of `reach`, which is told each step as it begins, and ends the process there.
"""

from collections.abc import Callable
from itertools import product
from typing import Final


def _go_on(_: str) -> None:
    return


reach: Callable[[str], None] = _go_on

STEPS: Final = (
    *(
        f"{action} {what}"
        for what, action in product(
            ("dataset", "session", "segment", "part", "manifest"),
            ("write", "sync", "rename", "settle"),  # settle: make the new name durable
        )
    ),
    "append frames",
    "sync frames",
    "drop segment",
    "drop journal",
)
