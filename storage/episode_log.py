"""The episodes in the journal of a session: what sources described, as long as the session goes on."""

from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from threading import Lock

from operators.errors import InputError
from operators.ports import Description
from storage import frames
from storage.following import Following
from storage.layout import episode_log
from storage.segment import OpenSegment


class EpisodeLog:
    """A segment of its own, of which nothing is dropped before the session ends.

    So an episode is written once, when it begins, and again when it changes, however long the session goes
    on. Several threads may use it.
    """

    def __init__(self, folder: Path, session: str, describe: Mapping[str, Description]) -> None:
        """Begin it in a session's folder, which has the journal's; it tells of nothing yet.

        Raises:
            OSError: if it cannot be written.
        """
        self._path, self._session, self._describe = episode_log(folder), session, describe
        self._following: Following = Following(describe)
        self._turn = Lock()
        self._suspect = False  # an fsync failed: what it was about may be lost
        self._segment = OpenSegment(self._path, session, frames.EPISODE_LOG)

    def keep(self) -> None:
        """Have all that sources describe by now durable; what cannot be told waits for who commits it.

        Raises:
            OSError: some of it may never become so; it may be tried again.
        """
        with self._turn:
            following = Following(self._describe) if self._suspect else self._following
            try:
                changes = following.look()
                bodies = [*chain.from_iterable(map(frames.episodes, changes))]
            except (InputError, TypeError, ValueError):  # the next commit says what is wrong
                return
            if self._suspect:  # all in another file: the fsync, tried again, could seem to work
                fresh = OpenSegment(self._path, self._session, frames.EPISODE_LOG, bodies)
                self._segment.close()
                self._following, self._segment = following, fresh
            elif bodies:
                self._segment.append(bodies)
            following.took(changes)
            self._suspect = True
            self._segment.sync()
            self._suspect = False

    def close(self) -> None:
        """Let go of the file; may be called again."""
        with self._turn:
            self._segment.close()
