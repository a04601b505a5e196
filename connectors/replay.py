"""Source that replays a recorded stream as fast as it was recorded."""

from collections.abc import AsyncIterator, Iterator
from functools import cached_property
from heapq import merge
from itertools import islice
from pathlib import PurePath
from typing import Generic, TypeVar

from operators.batch import ANNOTATIONS, Batch, Motion, Touch
from operators.errors import InputError
from operators.fingertip import Fingertip
from operators.ports import Clock, Description, Recording, Source

Given = TypeVar("Given", bound=Batch)


class Replay(Source[Given], Generic[Given]):
    """Recorded stream as a source: each row is a batch, due at its recorded time on the clock of the run.

    Rows keep their recorded timestamps. The first row of touch or motion, or of this stream, is due at the
    start of the run: sources of one recording are synchronous. The declaration of a flow does not read the
    recording.

    Args:
        recording: Recording to replay.
        kind: Type of the batches.
        fingers: Fingertips to replay (default: all recorded ones). The recording may lack annotations
            (episodes, truth).
    """

    stale_after = None  # a recording may have gaps
    in_run_time = False

    def __init__(
        self, recording: Recording, kind: type[Given], fingers: tuple[int, ...] | None = None
    ) -> None:
        self._recording, self._kind, self._chosen = recording, kind, fingers

    @property
    def kind(self) -> type[Given]:
        """Type of the batches."""
        return self._kind

    @cached_property
    def exact_kind(self) -> type[Batch]:
        """Type of the recorded batches: touch may be recorded zeroed."""
        if self._kind is not Touch or not self.fingers:
            return self._kind
        return type(next(iter(self._recording.read(self._kind, self.fingers[0], 1)), Touch.empty()))

    @cached_property
    def fingers(self) -> tuple[int, ...]:
        """Fingertips of the batches.

        Raises:
            InputError: if the recording has no such stream.
        """
        recorded, kind = self._recording.fingers(self._kind), self._kind
        for finger in self._chosen or recorded or (() if kind in ANNOTATIONS else (None,)):
            if finger not in recorded:
                which = "" if finger is None else f" of finger {finger}"
                others = f"; its fingers are {', '.join(map(str, recorded))}" if recorded else ""
                raise InputError(self._recording.name, f"has no {kind.__name__} stream{which}{others}")
        return self._chosen or recorded

    @cached_property
    def fingertip(self) -> Fingertip | None:
        """Fingertip of the recorded touch, if the recording states it; it may be measured."""
        return self._recording.fingertip(self._kind)

    @property
    def recording(self) -> str:
        """Name of the recording; of a path only the last part, as UTF-8, because the name is published."""
        return PurePath(self._recording.name).name.encode(errors="replace").decode()

    async def batches(self, clock: Clock) -> AsyncIterator[Given]:
        """Yield the whole stream, with the fingertips merged in the order of their timestamps."""
        kinds: set[type[Batch]] = {self._kind, Touch, Motion}
        keys = [(kind, each) for kind in kinds for each in self._recording.fingers(kind)]
        first = [_time(row) for key in keys for row in islice(self._recording.read(*key, 1), 1)]
        start = clock.now() - min(first, default=0)
        streams = [_rows(self._recording.read(self._kind, finger)) for finger in self.fingers]
        for row in merge(*streams, key=_time):
            await clock.sleep_until(start + _time(row))
            yield row

    def describe(self) -> Description:
        """Return the description of the recording."""
        return self._recording.describe()

    def __str__(self) -> str:
        return f"Replay({self._recording.name}, {self._kind.__name__})"


def _rows(batches: Iterator[Given]) -> Iterator[Given]:
    """Yield each row as a batch."""
    return (batch[row : row + 1] for batch in batches for row in range(len(batch)))


def _time(batch: Batch) -> int:
    return int(batch.time.item(0))
