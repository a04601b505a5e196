"""Episodes of a collection as a source."""

import asyncio
from collections.abc import AsyncIterator

from operators.batch import Episodes
from operators.ports import Clock, Description, Source


class EpisodeSource(Source[Episodes]):
    """Episodes of one session, each at its end; it describes the session.

    Args:
        about: Description of the session.
    """

    def __init__(self, about: Description) -> None:
        self._about = about
        self._episodes = asyncio.Queue[Episodes]()

    @property
    def kind(self) -> type[Episodes]:
        """Episodes."""
        return Episodes

    async def batches(self, clock: Clock) -> AsyncIterator[Episodes]:  # noqa: ARG002 - Source's signature
        """Give each episode once it has ended, until cancelled."""
        while True:
            yield await self._episodes.get()

    def emit(self, episode: Episodes) -> None:
        """Add an episode that has ended."""
        self._episodes.put_nowait(episode)

    def describe(self) -> Description:
        """Return the description of the session."""
        return self._about
