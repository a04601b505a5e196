"""slipflow, live: the flow in its live runner, with the job's score or a detector that ships."""

import asyncio
from collections.abc import AsyncIterator
from time import perf_counter_ns

import numpy as np

from flows.graph import Flow
from flows.run.live_runner import LiveRunner
from operators import Clock, Run, Score, Scores, Sink, Source, Touch, Zero
from operators.batch import BAROMETERS
from storage import load_detector
from tests.benchmarks.bench_engine import StepEnergy
from tests.benchmarks.peers.job import BASELINE
from tests.benchmarks.peers.live import Live, carry_out_live


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
        live, rows, valid = (
            self._live,
            list[tuple[int, int, np.ndarray]](),
            np.ones((1, BAROMETERS), np.bool_),
        )
        for finger, due, counts in live.records:
            rows.append((finger, due, np.array([counts], np.int16)))
        self.ahead = clock.now() - perf_counter_ns()
        live.begin()
        for finger, due, counts in rows:
            if (wait := live.wait(due)) > 0:
                await asyncio.sleep(wait)
            stamp = perf_counter_ns()
            yield Touch(np.array([stamp + self.ahead]), counts, counts, valid, finger=finger)


class Nothing(Sink[Scores]):
    """Takes the events, and does nothing."""

    def __init__(self, destination: str) -> None:
        self._destination = destination

    @property
    def destination(self) -> str:
        """Memory."""
        return self._destination

    async def open(self, run: Run) -> None:
        """Nothing is needed."""

    def take(self, batch: Scores) -> bool:
        """Take."""
        return True


class Told(Nothing):
    """Writes down when the events come."""

    def __init__(self, live: Live, source: Fingertips) -> None:
        super().__init__("told")
        self._live, self._source = live, source

    def take(self, batch: Scores) -> bool:
        """Take."""
        self._live.told(batch.finger, batch.time.item(0) - self._source.ahead, batch.probability.item(0))
        return True


def run(live: Live, detector: str, sinks: int = 1) -> None:
    """To the last event; the last of the sinks writes down when it comes."""

    async def carry() -> None:
        flow, source = Flow("path"), Fingertips(live)
        score = StepEnergy() if detector == "energy" else Score(load_detector(detector))
        events = flow.source(source) | Zero(baseline=BASELINE) | score
        for sink in range(1, sinks):
            events.to(Nothing(f"nothing {sink}"))
        events.to(Told(live, source))
        await LiveRunner(flow, "path").execute()

    asyncio.run(carry())


if __name__ == "__main__":
    carry_out_live(run)
