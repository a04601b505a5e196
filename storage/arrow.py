"""Lazy import of pyarrow, which takes 0.4 s."""

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
            found: object = getattr(import_module(self._name), attribute)
            vars(self)[attribute] = found  # the next read does not come here
            return found

    pa, pq = _Lazy("pyarrow"), _Lazy("pyarrow.parquet")

__all__ = ["load", "pa", "pq"]


def load() -> None:
    """Import pyarrow now, so that it does not delay a run later."""
    import_module("pyarrow.parquet")
