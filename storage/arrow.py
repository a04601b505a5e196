"""Lazy import of pyarrow, which takes 0.4 s, with memory from the C library.

Arrow's default allocator, mimalloc, keeps memory that it freed: up to 80 MB, growing, in a recording that
uses 1.5 MB at a time. Reading is equally fast. ARROW_DEFAULT_MEMORY_POOL=mimalloc selects it nevertheless.
"""

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq
else:

    class _Lazy:
        """Module that is imported when an attribute is read."""

        def __init__(self, name: str) -> None:
            self._name: Final = name

        def __getattr__(self, attribute: str) -> object:
            load()
            found: object = getattr(import_module(self._name), attribute)
            vars(self)[attribute] = found  # the next read does not come here
            return found

    pa, pq = _Lazy("pyarrow"), _Lazy("pyarrow.parquet")

__all__ = ["load", "pa", "pq"]


def load() -> None:
    """Import pyarrow now, so that it does not delay a run later."""
    if "pyarrow.parquet" in sys.modules:
        return
    arrow = import_module("pyarrow")
    if "ARROW_DEFAULT_MEMORY_POOL" not in os.environ:
        arrow.set_memory_pool(arrow.system_memory_pool())
    import_module("pyarrow.parquet")
