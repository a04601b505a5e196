"""A recorded session, to be scrubbed through in a browser."""

from collections.abc import Callable
from math import isnan, nan
from operator import itemgetter
from typing import Final

import numpy as np
from numpy.typing import NDArray

from connectors.events import finger_name
from connectors.web.page_frames import FINGERS
from connectors.web.series import drawn, series, shown
from operators.batch import SLIP, Motion, Scores, Slips, Times, Touch, Zeroed, ms, s
from operators.errors import InputError
from operators.ports import Json, Run, Sink

HELD: Final = 1 * s  # ns; a row that is older tells nothing of an instant
ROWS: Final = 20_000_000  # of a session, all streams together: a GB at most
EVENTS: Final = 20_000


class Recorded(Sink[Touch | Motion | Scores | Slips]):
    """Keeps what a page shows of a replay: its events, and all curves, of which any window can be had.

    Args:
        threshold: The probability from which a slip is decided, for the page to mark.
        about: What else the page is to say of it.
        flow: What recorded it.
        dataset: The name of the dataset that holds it.
    """

    def __init__(
        self,
        *,
        threshold: float | None = None,
        about: str = "",
        flow: str | None = None,
        dataset: str | None = None,
    ) -> None:
        self.threshold, self.about = threshold, about
        self._of: dict[str, Json] = {"flow": flow, "dataset": dataset}
        self.start = self.end = 0  # ns, of the first and the last row
        # by stream and fingertip: as it comes, and once all has come
        self._arriving: dict[tuple[str, str], list[tuple[Times, NDArray[np.float32]]]] = {}
        self._curves: dict[tuple[str, str], tuple[Times, NDArray[np.float32]]] = {}
        self._events: list[tuple[int, str, bool, float]] = []  # ns, fingertip, onset, probability
        self._zeroed, self._rows = False, 0

    @property
    def destination(self) -> str:
        """The memory of this process."""
        return "memory"

    async def open(self, run: Run) -> None:
        """Take what comes as of the start of `run`."""
        self._session, self.start = run.session, run.start

    async def write(self, batch: Touch | Motion | Scores | Slips) -> None:
        """Keep the rows.

        Raises:
            InputError: if there are more than can be kept.
        """
        finger = finger_name(batch.finger)
        if isinstance(batch, Slips):
            self._add_events(batch, finger)
        else:
            stream = (
                "touch" if isinstance(batch, Touch) else "speed" if isinstance(batch, Motion) else "scores"
            )
            self._zeroed |= isinstance(batch, Zeroed)
            values = shown(batch).astype(np.float32)
            self._arriving.setdefault((stream, finger), []).append((batch.time, values))
        self._rows += len(batch)
        self.end = max(self.end, int(batch.time.max(initial=self.start)))
        fingers = len({finger for _, finger in self._arriving})
        if self._rows > ROWS or len(self._events) > EVENTS or fingers > FINGERS:
            most = f"{ROWS:,} rows, {EVENTS:,} events and {FINGERS} fingertips"
            raise InputError(self._session, f"is too long to be shown: a page takes {most} at most")

    async def close(self) -> None:
        """Put the events in order, and the curves together; rows older than one before them are left out."""
        self._events.sort(key=itemgetter(0))  # fingertips were read one after the other
        for key, parts in self._arriving.items():
            time = np.concatenate([each for each, _ in parts])  # (n,) ns
            values = np.concatenate([each for _, each in parts])  # (n, ...)
            before = np.maximum.accumulate(time)[:-1]  # (n - 1,)
            kept = np.concatenate(([True], time[1:] > before))
            self._curves[key] = time[kept], values[kept]
        self._arriving.clear()

    def contents(self) -> dict[str, Json]:
        """What the page is told of it first; times in ms since `start`."""
        fingers = sorted({finger for stream, finger in self._curves if stream == "touch"})
        return {
            "session": self._session,
            **self._of,
            "about": self.about,
            "start": self.start / ms,
            "length": (self.end - self.start) / ms,
            "threshold": self.threshold,
            "fingers": [*fingers],
            "zeroed": self._zeroed,
            "deepest": self._deepest(),
            "events": [
                {
                    "id": number,
                    "t": (time - self.start) / ms,
                    "finger": finger,
                    "onset": onset,
                    "p": round(probability, 3),
                    "latency": None,  # a replay has none
                }
                for number, (time, finger, onset, probability) in enumerate(self._events, 1)
            ],
        }

    def window(self, begin: float, end: float, columns: int) -> dict[str, Json]:
        """The curves from `begin` to `end` (ms since `start`), as the streams of a frame.

        They draw a picture that is `columns` pixels wide: the least and the greatest of each column, so that
        no peak is lost.
        """
        first, last = (self.start + round(each * ms) for each in (begin, end))

        def cut(time: Times, values: NDArray[np.float32]) -> dict[str, Json]:
            rows = slice(*np.searchsorted(time, [first, last + 1]))
            return series(*drawn(time[rows], values[rows], first, last, columns), self.start)

        return self._streams(cut)

    def figures(self, instant: float) -> dict[str, Json]:
        """The rows that hold at an instant (ms since `start`), as streams of one row; of none after 1 s."""
        at = self.start + round(instant * ms)

        def newest(time: Times, values: NDArray[np.float32]) -> dict[str, Json]:
            first, end = np.searchsorted(time, [at - HELD, at + 1])
            rows = slice(max(first, end - 1), end)
            return series(time[rows], values[rows], self.start)

        return self._streams(newest)

    def _streams(self, cut: Callable[[Times, NDArray[np.float32]], dict[str, Json]]) -> dict[str, Json]:
        """What is cut out of each curve, as the streams of a frame."""
        document: dict[str, dict[str, Json]] = {"touch": {}, "scores": {}}
        speed: Json = None
        for (stream, finger), curve in self._curves.items():
            if stream == "speed":
                speed = cut(*curve)
            else:
                zeroed: dict[str, Json] = {"zeroed": self._zeroed} if stream == "touch" else {}
                document[stream][finger] = {**cut(*curve), **zeroed}
        return {**document, "speed": speed}

    def _deepest(self) -> float | None:
        """The least count of all cells, by which the page scales its maps."""
        touches = [values for (stream, _), (_, values) in self._curves.items() if stream == "touch"]
        least = min(
            (float(np.fmin.reduce(values, axis=None)) for values in touches if len(values)), default=nan
        )
        return None if isnan(least) else least

    def _add_events(self, batch: Slips, finger: str) -> None:
        rows = zip(batch.time.tolist(), batch.state.tolist(), batch.probability.tolist(), strict=True)
        self._events.extend((time, finger, state == SLIP, probability) for time, state, probability in rows)
