import asyncio
import io
from contextlib import redirect_stdout
from math import nan

from connectors import Console
from operators.batch import EVERY, Faults, Slips, ms, s
from operators.health import FaultKind
from operators.ports import Run


def slips(time: int, finger: int = 0) -> Slips:
    times = time, time + 10 * ms
    return Slips.rows(times, [1, 0], times, [0.931, nan], finger=finger)


FAULTS = Faults.rows([s, 2 * s], 3, FaultKind.STUCK, [True, False], finger=2)
SATURATED = Faults.rows([s, 2 * s], 3, FaultKind.SATURATED, [True, False], finger=2)


def printed(stream: io.StringIO, run: Run, *batches: Slips | Faults) -> list[str]:
    async def main() -> None:
        sink = Console()
        await sink.open(run)
        for batch in batches:
            await sink.write(batch)
        await sink.close()

    with redirect_stdout(stream):
        asyncio.run(main())
    return stream.getvalue().splitlines()


def test_each_slip_and_fault_is_one_line(run: Run) -> None:
    assert printed(io.StringIO(), run, slips(run.clock.now() - 12 * ms), FAULTS, SATURATED) == [
        "1970-01-01 00:01:39.988  finger 0  slip onset  p 0.93  sensor to event 12.0 ms",
        "1970-01-01 00:01:39.998  finger 0  slip end    p nan  sensor to event 2.0 ms",
        "1970-01-01 00:00:01.000  finger 2  barometer 3 stuck begins",
        "1970-01-01 00:00:02.000  finger 2  barometer 3 stuck ends",
        "1970-01-01 00:00:01.000  finger 2  barometer 3 range limit begins",
        "1970-01-01 00:00:02.000  finger 2  barometer 3 range limit ends",
    ]
    run.live = False
    onset, _ = printed(io.StringIO(), run, slips(0, EVERY))
    assert onset == "1970-01-01 00:00:00.000  finger every  slip onset  p 0.93"


async def test_events_without_a_standard_output_are_not_an_error() -> None:
    with redirect_stdout(None):
        await Console().write(FAULTS)
