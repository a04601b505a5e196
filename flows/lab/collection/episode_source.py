"""Source of the episodes of a collection."""

import asyncio
from collections.abc import AsyncIterator

from operators.batch import Episodes
from operators.ports import Clock, Description, Source


class EpisodeSource(Source[Episodes]):
    """Source of the episodes of one session, each at its end.

    Args:
        about: Description of the session.
    """

    stale_after = None  # episodes are rare

    def __init__(self, about: Description) -> None:
        self._about = about
        self._episodes = asyncio.Queue[Episodes]()

    @property
    def kind(self) -> type[Episodes]:
        """Episodes."""
        return Episodes

    async def batches(self, clock: Clock) -> AsyncIterator[Episodes]:  # noqa: ARG002 - Source's signature
        """Yield each episode when it has ended, until cancelled."""
        while True:
            yield await self._episodes.get()

    def emit(self, episode: Episodes) -> None:
        """Add an episode that has ended."""
        self._episodes.put_nowait(episode)

    def describe(self) -> Description:
        """Return the description of the session."""
        return self._about
