"""Steps at which tests kill a recording or a recovery; the files must be readable after a kill at any step.

`reach` is called at the start of each step; tests replace it to end the process there.
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
