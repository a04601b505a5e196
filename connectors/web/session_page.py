"""Page of a recorded session: sink that keeps the curves in memory, and the requests for them."""

import asyncio
from collections.abc import Callable, Mapping
from math import isnan, nan
from typing import Final

import numpy as np
from numpy.typing import NDArray

from connectors.events import finger_name
from connectors.web.curves import (
    curve_json,
    event_json,
    page_fingertip,
    plotted_values,
    stream_name,
    streams_json,
    thin_curve,
)
from connectors.web.page_frames import FINGERS_MAX
from connectors.web.web_server import Answer, Handler, json_answer
from operators.batch import Motion, Scores, Slips, Times, Touch, Zeroed, ms, s
from operators.errors import InputError
from operators.ports import Json, Run, Sink

VALID_FOR: Final = 1 * s  # ns, maximum age of a row in `values_at`
ROWS_MAX: Final = 20_000_000  # of all streams together, about 1 GB
EVENTS_MAX: Final = 20_000
_TIME_MAX: Final = 1e12  # ms
_COLUMNS_MAX: Final = 8192
_USAGE: Final = (
    "must be ?begin=MS&end=MS&at=MS&columns=N: ms since the start of the session; 1 to 8192 columns"
)


class SessionCurves(Sink[Touch | Motion | Scores | Slips]):
    """Sink that keeps the events and curves of a replay in memory.

    Args:
        threshold: Probability from which a sample counts as slip, marked on the page.
        about: Additional text for the page.
        flow: Name of the flow that recorded the session.
        dataset: Name of the dataset that contains the session.
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
        self._origin: dict[str, Json] = {"flow": flow, "dataset": dataset}
        self.start = self.end = 0  # ns, start of the run and newest row
        # by stream and fingertip: batches, and the curves joined in `close`
        self._arriving: dict[tuple[str, str], list[tuple[Times, NDArray[np.float32]]]] = {}
        self._curves: dict[tuple[str, str], tuple[Times, NDArray[np.float32]]] = {}
        self._events: list[tuple[str, tuple[int, int, float]]] = []  # fingertip; time, state, probability
        self._zeroed, self._falls, self._rows = False, True, 0

    @property
    def destination(self) -> str:
        """Constant name of the memory of this process."""
        return "memory"

    async def open(self, run: Run) -> None:
        """Set the session and the start of `run`."""
        self._session, self.start = run.session, run.start
        self._origin["fingertip"] = page_fingertip(run, self.destination)
        self._falls = all(
            each.falls is not False for each in run.fingertips.get(self.destination, {}).values()
        )

    def take(self, batch: Touch | Motion | Scores | Slips) -> bool:
        """Keep the rows of a batch.

        Raises:
            InputError: if the session has too many rows, events or fingertips.
        """
        finger = finger_name(batch.finger)
        if isinstance(batch, Slips):
            rows = zip(batch.time.tolist(), batch.state.tolist(), batch.probability.tolist(), strict=True)
            self._events.extend((finger, row) for row in rows)
        else:
            self._zeroed |= isinstance(batch, Zeroed)
            values = plotted_values(batch).astype(np.float32)
            self._arriving.setdefault((stream_name(batch), finger), []).append((batch.time, values))
        self._rows += len(batch)
        self.end = max(self.end, int(batch.time.max(initial=self.start)))
        fingers = len({finger for _, finger in self._arriving})
        if self._rows > ROWS_MAX or len(self._events) > EVENTS_MAX or fingers > FINGERS_MAX:
            most = f"{ROWS_MAX:,} rows, {EVENTS_MAX:,} events and {FINGERS_MAX} fingertips"
            raise InputError(self._session, f"is too long for a page, which shows at most {most}")
        return True

    async def close(self) -> None:
        """Sort the events and join the curves; out-of-order rows are dropped."""
        self._events.sort(key=lambda event: event[1][0])  # fingertips are written one after the other
        for key, parts in self._arriving.items():
            time = np.concatenate([each for each, _ in parts])  # (n,) ns
            values = np.concatenate([each for _, each in parts])  # (n, ...)
            before = np.maximum.accumulate(time)[:-1]  # (n - 1,)
            kept = np.concatenate(([True], time[1:] > before))
            self._curves[key] = time[kept], values[kept]
        self._arriving.clear()

    def contents(self) -> dict[str, Json]:
        """Return the first document of the page; times are in ms since `start`."""
        fingers = sorted({finger for stream, finger in self._curves if stream == "touch"})
        return {
            "session": self._session,
            **self._origin,
            "about": self.about,
            "start": self.start / ms,
            "length": (self.end - self.start) / ms,
            "threshold": self.threshold,
            "fingers": [*fingers],
            "zeroed": self._zeroed,
            "deepest": self._deepest(),
            "events": [
                event_json(number, finger, row, self.start, None)
                for number, (finger, row) in enumerate(self._events, 1)
            ],
        }

    def window(self, begin: float, end: float, columns: int) -> dict[str, Json]:
        """Return the curves from `begin` to `end` (ms since `start`) as the streams of a frame.

        Curves are reduced to the minimum and maximum of each of `columns` pixel columns.
        """
        first, last = (self.start + round(each * ms) for each in (begin, end))

        def cut(time: Times, values: NDArray[np.float32]) -> dict[str, Json]:
            rows = slice(*np.searchsorted(time, [first, last + 1]))
            return curve_json(*thin_curve(time[rows], values[rows], first, last, columns), self.start)

        return self._streams(cut)

    def values_at(self, instant: float) -> dict[str, Json]:
        """Return the newest row, at most 1 s old, of each stream at an instant (ms since `start`)."""
        at = self.start + round(instant * ms)

        def newest(time: Times, values: NDArray[np.float32]) -> dict[str, Json]:
            first, end = np.searchsorted(time, [at - VALID_FOR, at + 1])
            rows = slice(max(first, end - 1), end)
            return curve_json(time[rows], values[rows], self.start)

        return self._streams(newest)

    def _streams(self, cut: Callable[[Times, NDArray[np.float32]], dict[str, Json]]) -> dict[str, Json]:
        """Return the streams of a frame, each curve cut by `cut`."""
        found = {key: cut(*curve) for key, curve in self._curves.items()}
        empty: dict[str, Json] = {"touch": {}, "scores": {}, "speed": None}
        return {**empty, **streams_json(found, found if self._zeroed else ())}

    def _deepest(self) -> float | None:
        """Return the minimum of all cells, for the scale of the pressure maps; None without touch.

        If counts rise with pressure, it is minus their maximum.
        """
        touches = [values for (stream, _), (_, values) in self._curves.items() if stream == "touch"]
        sign = 1 if self._falls else -1
        least = min(
            (float(np.fmin.reduce(sign * values, axis=None)) for values in touches if len(values)),
            default=nan,
        )
        return None if isnan(least) else least


def session_handlers(curves: SessionCurves) -> dict[str, Handler]:
    """Return the requests of the page, by path: ``/about.json`` describes it, ``/window`` has curves.

    Documents are built in a thread, as that takes some ms.
    """

    async def about(query: Mapping[str, str]) -> Answer:  # noqa: ARG001 - no parameters
        return await asyncio.to_thread(lambda: json_answer({"mode": "recorded", **curves.contents()}))

    async def window(query: Mapping[str, str]) -> Answer:
        try:
            begin, end, at = (float(query[name]) for name in ("begin", "end", "at"))
            columns = int(query["columns"])
        except (KeyError, ValueError):
            raise InputError("/window", _USAGE) from None
        if not (
            -_TIME_MAX <= begin <= end <= _TIME_MAX and abs(at) <= _TIME_MAX and 0 < columns <= _COLUMNS_MAX
        ):
            raise InputError("/window", _USAGE)  # also for NaN
        return await asyncio.to_thread(
            lambda: json_answer({**curves.window(begin, end, columns), "at": curves.values_at(at)})
        )

    return {"/about.json": about, "/window": window}
