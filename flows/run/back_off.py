"""How long to wait before trying again what failed: twice as long each time."""

from typing import Final

FIRST_RETRY: Final = 0.1  # s
LAST_RETRY: Final = 5.0  # s, up to which the wait doubles
