"""What waits for one browser that looks at the page."""

import asyncio
from collections import deque
from typing import Final

WAITING: Final = 1 << 20  # bytes, that may wait


class Viewer:
    """A queue of messages for one browser, which loses the oldest of them where it is too slow."""

    def __init__(self, limit: int = WAITING) -> None:
        """Let at most `limit` bytes wait; a message that is longer is never given."""
        self.lost = 0  # messages
        self.size = 0  # bytes that wait
        self._limit = limit
        self._waiting: deque[bytes] = deque()
        self._more = asyncio.Event()
        self._ended = False

    def put(self, message: bytes) -> None:
        """Queue a message; the oldest ones go where there is no room."""
        self._waiting.append(message)
        self.size += len(message)
        while self.size > self._limit:
            self.size -= len(self._waiting.popleft())
            self.lost += 1
        self._more.set()

    def end(self) -> None:
        """No more will come."""
        self._ended = True
        self._more.set()

    async def take(self) -> bytes | None:
        """All that waits, one message behind the other, waiting for it; None: nothing will come any more."""
        while not self._waiting:
            if self._ended:
                return None
            self._more.clear()
            await self._more.wait()
        messages = b"".join(self._waiting)
        self._waiting.clear()
        self.size = 0
        return messages
