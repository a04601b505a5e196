import asyncio
import io

import numpy as np
import pytest

from connectors import Console
from operators.batch import EVERY, Faults, Slips, ms, s
from operators.health import FaultKind
from operators.ports import Run


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def slips(time: int, finger: int = 0) -> Slips:
    times = np.array([time, time + 10 * ms])
    return Slips(times, np.array([1, 0], np.int8), times, np.array([0.931, np.nan]), finger=finger)


FAULTS = Faults(
    np.array([s, 2 * s]),
    np.array([3, 3], np.int8),
    np.full(2, FaultKind.STUCK, np.int8),
    np.array([True, False]),
    finger=2,
)


def printed(stream: io.StringIO, run: Run, *batches: Slips | Faults) -> list[str]:
    async def main() -> None:
        sink = Console(stream)
        await sink.open(run)
        for batch in batches:
            await sink.write(batch)
        await sink.close()

    asyncio.run(main())
    return stream.getvalue().splitlines()


def test_each_onset_and_each_end_is_one_line_with_its_latency(run: Run) -> None:
    assert printed(io.StringIO(), run, slips(run.clock.now() - 12 * ms)) == [
        "1970-01-01 00:01:39.988  finger 0  slip onset  p 0.93  12.0 ms",
        "1970-01-01 00:01:39.998  finger 0  slip end    p nan  2.0 ms",
    ]


def test_what_is_replayed_has_no_latency(run: Run) -> None:
    run.live = False
    onset, _ = printed(io.StringIO(), run, slips(0, EVERY))
    assert onset == "1970-01-01 00:00:00.000  finger every  slip onset  p 0.93"


def test_each_change_of_a_fault_is_one_line(run: Run) -> None:
    assert printed(io.StringIO(), run, FAULTS) == [
        "1970-01-01 00:00:01.000  finger 2  barometer 3 stuck begins",
        "1970-01-01 00:00:02.000  finger 2  barometer 3 stuck ends",
    ]


def test_a_terminal_gets_the_same_lines_in_colour(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    plain, coloured = printed(io.StringIO(), run, slips(0)), printed(Terminal(), run, slips(0))
    assert len(coloured) == len(plain)
    for line, colour in zip(plain, coloured, strict=True):
        assert colour.startswith("\x1b[")
        assert line in colour


def test_a_console_stands_for_its_stream() -> None:
    assert Console().place == Console().place
    assert Console(io.StringIO()).place != ""
