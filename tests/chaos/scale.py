"""Size of a test."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Scale:
    """Full test, or the short one of the test suite."""

    seed: int = 0  # of all random draws
    short: bool = False
