"""Labels of a recorded session as runs of equal values: by arm speed, and by true sliding in simulation."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from connectors.events import finger_name
from connectors.sim.truth import true_slips
from connectors.web.curves import GAP
from operators.batch import SLIP, STATIC, UNKNOWN, Codes, Labelled, Times, Truth, concat, ms
from operators.ports import Json, Run, Sink

ARM: Final = "arm"  # names of the bands
TRUTH: Final = "truth"


@dataclass(frozen=True, slots=True)
class Runs:
    """Runs of equal codes, in order of time; a pause of more than 250 ms ends a run."""

    begin: Times  # (k,) ns
    end: Times  # (k,) ns
    code: Codes  # (k,)

    @classmethod
    def of(cls, time: Times, code: Codes) -> "Runs":
        """Return the runs of rows; out-of-order rows are dropped.

        >>> runs = Runs.of(np.array([0, 10, 20]), np.array([0, 1, 1], np.int8))
        >>> runs.begin.tolist(), runs.end.tolist(), runs.code.tolist()
        ([0, 10], [10, 20], [0, 1])
        """
        kept = np.concatenate(([True], time[1:] > np.maximum.accumulate(time)[:-1]))[: len(time)]
        time, code = time[kept], code[kept]
        pauses = np.diff(time) > GAP
        breaks = np.flatnonzero((code[1:] != code[:-1]) | pauses) + 1
        first = np.concatenate(([0], breaks))[: len(time)].astype(np.intp)
        last = np.append(breaks, len(time))[: len(first)] - 1
        end = time[np.where(np.append(pauses, True)[last], last, last + 1)] if len(time) else time
        return cls(time[first], end, code[first])

    def between(self, begin: int, end: int, columns: int, origin: int) -> list[Json]:
        """Return [begin, end, code] of the runs between two times, in ms since `origin` (all ns).

        Of more runs than twice the pixel columns, those narrower than a column are left out.
        """
        rows = slice(self.end.searchsorted(begin), self.begin.searchsorted(end, "right"))
        first, last, code = self.begin[rows], self.end[rows], self.code[rows]
        if len(first) > 2 * columns:
            wide = (last - first) * columns >= end - begin
            first, last, code = first[wide], last[wide], code[wide]
        times = [((each - origin) / ms).round(3).tolist() for each in (first, last)]
        return [list(run) for run in zip(*times, code.tolist(), strict=True)]


class SessionBands(Sink[Labelled | Truth]):
    """Sink that keeps the labels of a replay as runs, by band and fingertip."""

    def __init__(self) -> None:
        self._start = 0  # ns; not set if the session has no labels
        self.runs: dict[tuple[str, str], Runs] = {}
        self._labels: dict[str, list[tuple[Times, Codes]]] = {}  # by fingertip
        self._truth: dict[str, list[Truth]] = {}

    @property
    def destination(self) -> str:
        """Constant name of the memory of this process."""
        return "memory of labels"

    async def open(self, run: Run) -> None:
        """Set the start of `run`."""
        self._start = run.start

    def take(self, batch: Labelled | Truth) -> bool:
        """Keep the labels of a batch."""
        if isinstance(batch, Truth):
            self._truth.setdefault(finger_name(batch.finger), []).append(batch)
        else:
            self._labels.setdefault(finger_name(batch.finger), []).append((batch.time, batch.label))
        return True

    async def close(self) -> None:
        """Join the labels to runs."""
        for finger, parts in self._labels.items():
            self.runs[ARM, finger] = Runs.of(*(np.concatenate(each) for each in zip(*parts, strict=True)))
        for finger, truths in self._truth.items():
            truth = concat(Truth, truths)
            code = np.full(len(truth), STATIC, np.int8)
            for onset, end in true_slips(truth):
                code[(truth.time >= onset) & (truth.time <= end)] = SLIP
            self.runs[TRUTH, finger] = Runs.of(truth.time, code)
        self._labels.clear()
        self._truth.clear()

    def window(self, begin: float, end: float, columns: int) -> dict[str, Json]:
        """Return the runs from `begin` to `end` (ms since the start) by band and fingertip."""
        first, last = (self._start + round(each * ms) for each in (begin, end))
        found: dict[str, dict[str, Json]] = {}
        for (band, finger), runs in self.runs.items():
            found.setdefault(band, {})[finger] = [*runs.between(first, last, columns, self._start)]
        return {**found}

    def codes(self, band: str, finger: str, time: Times) -> Codes:
        """Return the code of a band at each time (n,) ns; unknown where there is none."""
        runs = self.runs.get((band, finger))
        if runs is None or not len(runs.begin):
            return np.full(len(time), UNKNOWN, np.int8)
        row = runs.begin.searchsorted(time, "right") - 1
        found: Codes = np.where((row >= 0) & (time <= runs.end[row]), runs.code[row], np.int8(UNKNOWN))
        return found
