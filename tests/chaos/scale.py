"""How much of a promise is put to the test."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Scale:
    """The whole test, or the short one that belongs to the suite."""

    seed: int = 0  # of what is drawn by chance
    short: bool = False
