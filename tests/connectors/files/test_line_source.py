"""Growing files and real serial ports (pseudo-terminals), which the tests write."""

import asyncio
from collections.abc import AsyncGenerator, Sequence
from contextlib import aclosing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from connectors import LineSource
from connectors.files.column_map import ColumnMap
from connectors.files.line_decoder import HOPELESS, LineDecoder
from flows.run.clocks import LoopClock
from operators import EndpointError, ParameterError, Touch, Zeroed, concat, ms, s

pytestmark = pytest.mark.virtual

MAP = ColumnMap({"time": ("t",), "counts": ("a", "b")}, {"time": "ms", "counts": "count"}, rate=100.0)
NAMES = "t,a,b,spare"


def line(row: int, start: int = 5000) -> str:
    """Return a line of a logger at 100 Hz whose clock is at `start` (ms)."""
    return f"{start + 10 * row},{row},{1000 - row},x"


def text(rows: Sequence[int], start: int = 5000) -> str:
    return "".join(f"{line(row, start)}\r\n" for row in rows)


def first_cells(batches: Sequence[Touch]) -> list[int]:
    found: list[int] = concat(Touch, list(batches)).counts[:, 0].tolist() if batches else []
    return found


# --- lines ---

WRONG = "|  |5000|5000,1,2|x,1,2,3|5000,1.5,2,x|5000,99999,2,x|\x00\ufffd|1,2,3,4,5,6|inf,1,2,x"
wrong = st.sampled_from(WRONG.split("|")) | st.text("abc;\t.", min_size=1, max_size=20)


@given(
    st.lists(st.one_of(st.just(None), st.just(NAMES), wrong), max_size=40),
    st.lists(st.integers(0, 900), max_size=20),
    st.sampled_from(["\n", "\r\n", "\r"]),
)
@example([None, "5010", None, NAMES, None, None], [], "\n")
def test_each_sound_line_is_a_row_for_any_cut_and_each_damaged_one_is_counted(
    lines: list[str | None], cuts: list[int], end: str
) -> None:
    numbers = iter(range(len(lines)))
    sent = [line(next(numbers)) if each is None else each for each in lines]
    data = "".join(f"{each}{end}" for each in [NAMES, *sent]).encode() + b"50"  # half a line
    counted = dict.fromkeys(["lines", "damaged", "restarts"], 0)
    decoder, batches = LineDecoder("logger", MAP, (), counted), list[Touch]()
    places = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    for arrival, (begin, stop) in enumerate(pairwise(places)):
        batches += decoder.feed(data[begin:stop], 100 * s + arrival * ms)
    assert first_cells(batches) == list(range(lines.count(None)))
    assert counted["damaged"] == sum(each not in (None, NAMES) and bool(each.strip()) for each in lines)
    assert counted["restarts"] == lines.count(NAMES)
    times = np.concatenate([batch.time for batch in batches]) if batches else np.zeros(0)
    assert (np.diff(times) >= 0).all()


@pytest.mark.parametrize(("unit", "start"), [("ms", 5000), ("us", 2**32 - 55_000)])
def test_a_clock_that_starts_again_or_wraps_is_a_restart_and_rows_keep_their_intervals(
    unit: str, start: int
) -> None:
    columns = replace(MAP, units={"time": unit, "counts": "count"})
    counted = dict.fromkeys(["lines", "damaged", "restarts"], 0)
    decoder, step = LineDecoder("logger", columns, NAMES.split(","), counted), 10 if unit == "ms" else 10_000
    times = [(start + step * row) % 2**32 if row < 20 else step * row - 10 * step for row in range(40)]
    sent = [f"{time},{row},0,x\n".encode() for row, time in enumerate(times)]
    found = [touch for row, each in enumerate(sent) for touch in decoder.feed(each, 100 * s + row * 10 * ms)]
    assert first_cells(found) == [*range(40)]
    assert (np.diff(concat(Touch, found).time) == 10 * ms).all()
    assert (counted["restarts"], counted["damaged"]) == (1 + (unit == "us"), 0)


@pytest.mark.parametrize(
    ("columns", "names", "row"),
    [
        (replace(MAP, decimal="comma", separator="semicolon", resolution=0.1), "t;a;b", "5000,5;1,2;-3"),
        (
            replace(MAP, columns={"time": ("column1",), "counts": ("column2", "column3")}, resolution=0.1),
            "",
            "5,1.2,-3",
        ),
        (replace(MAP, resolution=0.1, units={"counts": "count"}), "a,b,t", "1.2,-3,2025-03-26 14:29:06.010"),
        (replace(MAP, columns={"counts": ("a", "b")}, resolution=0.1, zeroed=True), "b,a", "-3,1.2"),
        (replace(MAP, resolution=0.1, missing=(-999.0,)), "t,a,b", "5,1.2,-3"),
    ],
)
def test_numbers_and_times_have_the_formats_of_import(columns: ColumnMap, names: str, row: str) -> None:
    decoder = LineDecoder("logger", columns, (), dict.fromkeys(["lines", "damaged", "restarts"], 0))
    [touch] = decoder.feed(f"{names}\n{row}\n{row.replace('1.2', '-999')}\n".encode(), s)
    assert touch.counts[0].tolist() == [12, -30]
    assert touch.valid[0].all()
    assert touch.valid[1, 0] == (columns.missing is None)
    assert isinstance(touch, Zeroed) == bool(columns.zeroed)


def test_lines_that_are_never_rows_are_an_error_that_says_why() -> None:
    counted = dict.fromkeys(["lines", "damaged", "restarts"], 0)
    with pytest.raises(
        EndpointError, match=r"no line has the names t, a, b: restart the logger, or state names"
    ):
        [*LineDecoder("logger", MAP, (), counted).feed(text(range(HOPELESS)).encode(), s)]
    with pytest.raises(EndpointError, match="a line has 1 of 4 fields"):
        [*LineDecoder("logger", MAP, NAMES.split(","), counted).feed(b"\xf3\x01\n" * HOPELESS, s)]
    with pytest.raises(EndpointError, match="no end of a line"):
        [*LineDecoder("logger", MAP, (), counted).feed(b"\xf3" * 70_000, s)]


# --- files ---


class Reader:
    """The rows of a source, collected in the background."""

    def __init__(self, source: LineSource) -> None:
        self.source, self.batches, self.errors = source, list[Touch](), list[str]()
        self.task = asyncio.create_task(self._run())

    async def _run(self) -> None:
        while True:
            try:
                batches = cast("AsyncGenerator[Touch]", self.source.batches(LoopClock()))
                async with aclosing(batches):
                    async for batch in batches:
                        self.batches.append(batch)
            except EndpointError as error:
                self.errors.append(error.reason)
            await asyncio.sleep(0.1)

    @property
    def counts(self) -> dict[str, int]:
        return cast("dict[str, int]", self.source.describe()["lines"])

    async def rows(self) -> list[int]:
        """Return the rows that are there after a moment."""
        await asyncio.sleep(0.5)
        return first_cells(self.batches)


async def test_a_file_is_followed_from_its_end_and_half_a_line_waits(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"# a logger\n{NAMES}\n{text(range(3))}50")
    reader = Reader(LineSource(path, MAP))
    assert await reader.rows() == []
    with path.open("a") as file:
        file.write("30,3,997,x\n5040,4,9")
        file.flush()
        assert await reader.rows() == [3]
        file.write("96,x\n5050,oh\n" + text([6]))
    assert await reader.rows() == [3, 4, 6]
    assert reader.counts == {"lines": 4, "damaged": 1, "restarts": 0}
    assert caplog.messages == [f"{path}: 1 damaged lines so far; the newest: a line has 2 of 4 fields"]
    reader.task.cancel()


@pytest.mark.parametrize("how", ["truncated", "replaced", "renamed"])
async def test_a_file_that_is_begun_anew_is_read_from_its_start(tmp_path: Path, how: str) -> None:
    path, other = tmp_path / "log.csv", tmp_path / "other.csv"
    path.write_text(f"{NAMES}\n{text(range(50))}50")
    reader = Reader(LineSource(path, MAP))
    assert await reader.rows() == []
    if how == "renamed":
        path.rename(other)
        assert await reader.rows() == []
        with other.open("a") as file:
            file.write("50,55,0,x\n")  # the logger still writes to it
        assert await reader.rows() == [55]
        path.write_text(f"{NAMES}\n{text(range(3), start=0)}")
    elif how == "replaced":
        other.write_text(f"{NAMES}\n{text(range(3), start=0)}")
        other.rename(path)
    else:
        path.write_text(f"{NAMES}\n{text(range(3), start=0)}")
    assert (await reader.rows())[-3:] == [0, 1, 2]
    assert (reader.errors, reader.counts["restarts"]) == ([], 1)
    reader.task.cancel()


async def test_a_missing_file_is_an_error_and_read_from_its_start_once_it_exists(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    reader = Reader(LineSource(path, MAP))
    assert await reader.rows() == []
    assert set(reader.errors) == {"does not exist: is it plugged in, does the logger write there?"}
    path.write_text(f"{NAMES}\n{text(range(2))}")
    assert await reader.rows() == [0, 1]
    reader.task.cancel()


async def test_rows_have_the_host_time_of_the_loggers_clock(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{NAMES}\n")
    reader = Reader(LineSource(path, MAP))
    assert await reader.rows() == []
    for burst in range(20):  # a logger that writes ten rows at a time
        with path.open("a") as file:
            file.write(text(range(10 * burst, 10 * burst + 10)))
        await asyncio.sleep(0.1)
    time = concat(Touch, reader.batches).time
    assert len(time) == 200
    late = time[100:] - time[100] - np.arange(100) * 10 * ms
    assert np.abs(late).max() <= 10 * ms
    reader.task.cancel()


# --- parameters ---


def test_a_map_may_be_a_text_or_a_file(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(MAP.toml(), encoding="utf-8")
    for columns in ("time=t,counts=a,b,units.time=ms,units.counts=count,rate=100", tmp_path / "own.toml"):
        source = LineSource("log.csv", columns)
        assert (source.fingertip, source.fingers) == (LineSource("log.csv", MAP).fingertip, (0,))


def test_ports_are_told_from_files(tmp_path: Path) -> None:
    ports, files = ["/dev/ttyACM0", "COM3", "socket://10.0.0.5:3333"], ["log.csv", str(tmp_path / "COM3")]
    assert [LineSource(each, MAP).extra for each in (*ports, *files)] == ["serial"] * 3 + ["", ""]


@pytest.mark.parametrize(
    ("where", "columns", "baud"),
    [
        ("", MAP, 9600),
        ("x", replace(MAP, rate=None), 9600),
        ("x", MAP, 0),
        ("x", "time=t,rate=100", 9600),
        ("x", "time=t,counts=p*,rate=100", 9600),
    ],
)
def test_invalid_parameters_are_refused(where: str, columns: ColumnMap | str, baud: int) -> None:
    with pytest.raises(ParameterError):
        LineSource(where, columns, baud=baud)
    with pytest.raises(ParameterError, match="names is 't,a', must be all columns of the logger, also b of"):
        LineSource("COM3", MAP, names=("t", "a"))
