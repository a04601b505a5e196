"""Source that replays a recorded stream, at full speed or paced."""

from collections.abc import AsyncIterator, Iterator
from heapq import merge
from pathlib import PurePath
from typing import Generic, TypeVar

from operators.batch import ANNOTATIONS, Batch
from operators.checks import check_above
from operators.errors import InputError
from operators.ports import Clock, Description, Recording, Source

Given = TypeVar("Given", bound=Batch)


class Replay(Source[Given], Generic[Given]):
    """Recorded stream as a source; rows keep their recorded timestamps.

    Args:
        recording: Recording to replay.
        kind: Type of the batches.
        fingers: Fingertips to replay (default: all recorded ones). The recording may lack annotations
            (episodes, truth).
        pace: Recorded seconds per second of the clock (default 1), one row per batch; None for full speed,
            1000 rows per batch.
        origin: Recorded time (ns) of the start of the run (default: the first timestamp of this stream). Set
            the same origin for all streams of a recording, to keep them synchronous.

    Raises:
        InputError: if the recording has no such stream.
        ParameterError: if `pace` is not above 0.
    """

    stale_after = None  # a recording may have gaps

    def __init__(
        self,
        recording: Recording,
        kind: type[Given],
        fingers: tuple[int, ...] | None = None,
        *,
        pace: float | None = 1.0,
        origin: int | None = None,
    ) -> None:
        if pace is not None:
            check_above("Replay", "pace", pace, 0)
        recorded = recording.fingers(kind)
        for finger in fingers or recorded or (() if kind in ANNOTATIONS else (None,)):
            if finger not in recorded:
                which = "" if finger is None else f" of finger {finger}"
                others = f"; its fingers are {', '.join(map(str, recorded))}" if recorded else ""
                raise InputError(recording.name, f"has no {kind.__name__} stream{which}{others}")
        self._recording, self._kind, self._fingers = recording, kind, fingers or recorded
        self._pace, self._origin = pace, origin

    @property
    def kind(self) -> type[Given]:
        """Type of the batches."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """Fingertips of the batches."""
        return self._fingers

    @property
    def recording(self) -> str:
        """Name of the recording; of a path only the last part, because the name is published."""
        return PurePath(self._recording.name).name

    async def batches(self, clock: Clock) -> AsyncIterator[Given]:
        """Yield the whole stream, with the fingertips merged in the order of their timestamps."""
        start, origin = clock.now(), self._origin
        streams = [self._recording.read(self._kind, finger) for finger in self._fingers]
        for batch in merge(*streams if self._pace is None else map(_rows, streams), key=_first):
            if self._pace is not None:
                if origin is None:
                    origin = _first(batch)
                await clock.sleep_until(start + round((_first(batch) - origin) / self._pace))
            yield batch

    def describe(self) -> Description:
        """Return the description of the recording."""
        return self._recording.describe()

    def __str__(self) -> str:
        return f"Replay({self._recording.name}, {self._kind.__name__})"


def _rows(batches: Iterator[Given]) -> Iterator[Given]:
    """Yield each row as a batch."""
    return (batch[row : row + 1] for batch in batches for row in range(len(batch)))


def _first(batch: Batch) -> int:
    return int(batch.time.item(0))
