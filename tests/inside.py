"""Access to private attributes in tests."""

from typing import Any


def inside(owner: object, *names: str) -> Any:
    """Return a private attribute of an object, or an attribute of that attribute."""
    for name in names:
        owner = vars(owner)[name]
    return owner
