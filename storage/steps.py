"""Steps at which a recording or a recovery can be killed; what is left after each must be readable.

Tests replace `reach`, which is called at the start of each step, to end the process there.
"""

from collections.abc import Callable
from itertools import product
from typing import Final


def _continue(_: str) -> None:
    return


reach: Callable[[str], None] = _continue

STEPS: Final = (
    *(
        f"{action} {file}"
        for file, action in product(
            ("dataset", "session", "segment", "part", "manifest"),
            ("write", "sync", "rename", "sync name of"),
        )
    ),
    "append frames",
    "sync frames",
    "delete segment",
    "delete journal",
)
