"""slipflow, live: the flow in its live runner, with the job's score or a detector that ships."""

import asyncio
from collections.abc import AsyncIterator
from math import inf
from time import perf_counter_ns
from typing import Any

from flows.graph import Flow
from flows.run.live_runner import LiveRunner
from operators import Clock, Run, Score, Scores, Sink, Source, Touch, Zero
from storage import load_detector
from tests.benchmarks.peers.job import BASELINE, LENGTH
from tests.benchmarks.peers.live import Live, carry_out_live
from tests.benchmarks.peers.slipflow_batches import StepEnergy


class Fingertips(Source[Touch]):
    """Hands each sample over when it is due."""

    def __init__(self, live: Live) -> None:
        self._live = live
        self.ahead = 0  # ns, by which the run's time is ahead of `perf_counter_ns`

    @property
    def kind(self) -> type[Touch]:
        """Touch."""
        return Touch

    @property
    def fingers(self) -> tuple[int, ...]:
        """All of the job."""
        return tuple(range(len(self._live.job.time)))

    async def batches(self, clock: Clock) -> AsyncIterator[Touch]:
        """A batch of one for each sample, stamped in the run's time."""
        live = self._live
        rows = list[tuple[int, int, Any, Any]]()
        for finger, due, counts in live.records:
            packed = Touch.rows([0], [counts], [counts], True).packed
            rows.append((finger, due, packed, packed["time"]))
        self.ahead = clock.now() - perf_counter_ns()
        live.begin()
        for finger, due, packed, time in rows:
            if (wait := live.wait(due)) > 0:
                await asyncio.sleep(wait)
            time[0] = perf_counter_ns() + self.ahead
            yield Touch.unpack(packed, finger)


class Told(Sink[Scores]):
    """Writes down when the events come."""

    destination = "told"

    def __init__(self, live: Live, source: Fingertips) -> None:
        self._live, self._source = live, source

    async def open(self, run: Run) -> None:
        """Nothing is needed."""

    def take(self, batch: Scores) -> bool:
        """Take."""
        for time, score in batch.packed.tolist():
            self._live.told(batch.finger, time - self._source.ahead, score)
        return True


def run(live: Live, detector: str) -> None:
    """To the last event."""

    async def carry() -> None:
        flow, source = Flow("path"), Fingertips(live)
        score = StepEnergy() if detector == "energy" else Score(load_detector(detector))
        length = score.detector.length if isinstance(score, Score) else LENGTH
        live.expected -= len(live.job.time) * (length - LENGTH)
        events = flow.source(source) | Zero(baseline=BASELINE, spike=inf) | score
        events.to(Told(live, source))
        await LiveRunner(flow, "path").execute()

    asyncio.run(carry())


if __name__ == "__main__":
    carry_out_live(run)
