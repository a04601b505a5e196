"""Giving a recorded stream again, as fast as possible or paced like the original."""

from collections.abc import AsyncIterator, Iterator
from heapq import merge
from pathlib import PurePath
from typing import Generic, TypeVar

from operators.batch import Batch
from operators.errors import InputError, ParameterError
from operators.ports import Clock, Description, Recording, Source

Given = TypeVar("Given", bound=Batch)


class Replay(Source[Given], Generic[Given]):
    """A recorded stream as a source; rows keep their recorded stamps.

    Args:
        recording: where it is.
        kind: the type of its batches.
        fingers: the fingertips to give, by default all that were recorded.
        pace: recorded seconds per second of the clock, each row on its own when it is due; None: in batches
            of 1000 rows, never waiting.
        origin: recorded time (ns) that stands for the start of the run. Streams of one recording must share
            it to keep their distance in time; by default it is the first stamp of this stream.

    Raises:
        InputError: if the recording holds no such stream.
        ParameterError: on a pace that is not above 0.
    """

    def __init__(
        self,
        recording: Recording,
        kind: type[Given],
        fingers: tuple[int, ...] | None = None,
        *,
        pace: float | None = 1.0,
        origin: int | None = None,
    ) -> None:
        if pace is not None and not pace > 0:
            raise ParameterError("Replay", "pace", pace, "above 0, or None for as fast as possible")
        held = recording.fingers(kind)
        for finger in fingers or held or (None,):
            if finger not in held:
                which = "" if finger is None else f" of finger {finger}"
                others = f"; its fingers are {', '.join(map(str, held))}" if held else ""
                raise InputError(recording.name, f"holds no {kind.__name__} stream{which}{others}")
        self._recording, self._kind, self._fingers = recording, kind, fingers or held
        self._pace, self._origin = pace, origin

    @property
    def kind(self) -> type[Given]:
        """The type of its batches."""
        return self._kind

    @property
    def fingers(self) -> tuple[int, ...]:
        """The fingertips that its batches belong to."""
        return self._fingers

    @property
    def recording(self) -> str:
        """What the recording is called: of a path the last part, for others are told this name."""
        return PurePath(self._recording.name).name

    async def batches(self, clock: Clock) -> AsyncIterator[Given]:
        """Give all of the stream, from its beginning; fingertips take turns in the order of their stamps."""
        start, origin = clock.now(), self._origin
        streams = [self._recording.read(self._kind, finger) for finger in self._fingers]
        for batch in merge(*streams if self._pace is None else map(_rows, streams), key=_first):
            if self._pace is not None:
                if origin is None:
                    origin = _first(batch)
                await clock.sleep_until(start + round((_first(batch) - origin) / self._pace))
            yield batch

    def describe(self) -> Description:
        """What the recording says of itself."""
        return self._recording.describe()

    def __str__(self) -> str:
        return f"Replay({self._recording.name}, {self._kind.__name__})"


def _rows(batches: Iterator[Given]) -> Iterator[Given]:
    """Each row as a batch of its own."""
    return (batch[row : row + 1] for batch in batches for row in range(len(batch)))


def _first(batch: Batch) -> int:
    return int(batch.time.item(0))
