"""Retry delays with exponential back-off."""

from dataclasses import dataclass, field


@dataclass
class BackOff:
    """Delays (s) that double with each failure, from `first` to `last`.

    >>> retry = BackOff(first=0.1, last=0.3)
    >>> retry.delay(), retry.delay(), retry.delay()
    (0.1, 0.2, 0.3)
    >>> retry.reset()
    >>> retry.delay()
    0.1
    """

    first: float = 0.1  # s
    last: float = 5.0  # s
    _next: float = field(default=0.0, init=False, repr=False)

    def delay(self) -> float:
        """Return the delay (s) before the next attempt, and double the one after it."""
        delay = self._next or self.first
        self._next = min(2 * delay, self.last)
        return delay

    def reset(self) -> None:
        """Restart at `first`, after a success."""
        self._next = 0.0
