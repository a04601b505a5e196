"""Formats of the numbers and times of a file as a whole."""

import datetime as dt
import shlex
from collections.abc import Sequence

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.interpretation import Part
from connectors.files.number_format import reals, with_decimal
from connectors.files.raw_table import RawTable
from connectors.files.time_axis import of_texts
from connectors.files.trace import interpreted
from operators.batch import ms, s
from operators.errors import InputError

UNIT = "and a unit, as units.counts=kPa, or"
SOME = np.random.default_rng(0).permutation(np.arange(1, 999))  # rows that are lost


def concluded(texts: list[str], separator: str = "semicolon", columns: str = "") -> str:
    column = pl.Series("p0", texts, pl.String)
    table = RawTable({"p0": column}, "pad", "line", np.arange(len(texts)), separator=separator)
    found = with_decimal(table, ColumnMap.parse(f"counts=p0,{columns}"))
    table.stop()
    return found.decimal_sign


@given(
    st.lists(st.floats(-1e7, 1e7).map(lambda value: round(value, 3)), min_size=2, max_size=9),
    st.sampled_from(".,"),
    st.sampled_from(["", "'", "\u202f", "other"]),
)
def test_a_number_is_read_or_its_format_is_refused(numbers: list[float], decimal: str, group: str) -> None:
    group = ",."[decimal == ","] if group == "other" else group
    texts = [f"{each:,.3f}".replace(",", "\0").replace(".", decimal).replace("\0", group) for each in numbers]
    try:
        found = reals(pl.Series(texts, dtype=pl.String), concluded(texts)).to_list()
    except InputError as error:
        doubtful = [text for text in texts if text.count(decimal) == 1 and len(text) < 9]
        assert doubtful or "both" in str(error)  # noqa: PT017 - of both outcomes one is right
        return
    assert all(
        value == number or (value is None and group and group in text)
        for value, number, text in zip(found, numbers, texts, strict=True)
    )


@pytest.mark.parametrize(
    ("texts", "sign"),
    [
        (["0,01", "101,248"], ","),
        (["101,325", "101,4"], ","),
        (["7", "8"], "."),
        (["1,234,567"], r"one of them twice \(column p0: 1,234,567\): remove the signs of thousands"),
        (["1e-3", "2.5e2"], "."),
        (["101,248", "7"], f"may have decimals or thousands; state decimal=comma {UNIT}"),
        (["101.248", "7"], f"may have decimals or thousands; state decimal=point {UNIT}"),
        (["3,000", "4,000"], rf"decimal=comma {UNIT} remove the signs of thousands .*\)$"),
        (["0.01", "101,248"], r"both point and comma, .* \(column p0: 0.01 and column p0: 101,248\): remove"),
        (["1.234,5", "7"], r"both point and comma, .* \(column p0: 1.234,5 and column p0: 1.234,5\): remove"),
    ],
)
def test_the_file_as_a_whole_decides_the_sign_of_decimals(texts: list[str], sign: str) -> None:
    if len(sign) == 1:
        assert concluded(texts) == sign
    else:
        with pytest.raises(InputError, match=sign):
            concluded(texts)
    assert concluded(["101.248"], "comma") == "."
    assert concluded(texts, columns="decimal=comma") == ","


def test_a_number_in_another_format_is_no_number() -> None:
    texts = ["1,5", "1.234,5", "1.5", "1,234", "1 000,5", "1'000", "-,5", "x", "", "NA", "1,2,3", "inf"]
    found = reals(pl.Series(texts), ",").to_list()
    assert [None if each is None else "nan" if each != each else each for each in found] == [  # noqa: PLR0124
        *(1.5, None, None, 1.234, None, None, -0.5, None, "nan", "nan", None, None)
    ]


moments = st.datetimes(dt.datetime(1971, 1, 1), dt.datetime(2260, 1, 1))  # noqa: DTZ001 - UTC


@given(
    moments, st.sampled_from(["ymd", "dmy", "mdy"]), *map(st.sampled_from, ("./-", ".,", ["", "am or pm"]))
)
def test_dates_are_read_in_each_order(
    moment: dt.datetime, order: str, sign: str, dot: str, half: str
) -> None:
    day = moment.strftime(sign.join({"y": "%Y", "d": "%d", "m": "%m"}[each] for each in order))
    clock = moment.strftime("%I:%M:%S.%f %p" if half else "%H:%M:%S.%f").replace(".", dot)
    expected = (moment - dt.datetime(1970, 1, 1)) // dt.timedelta(microseconds=1) * 1000  # noqa: DTZ001
    assert of_texts(pl.Series([f"{day} {clock}"]), order)[0] == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2025-03-26T14:29:06.123456789Z", 1742999346123456789),
        ("2025-03-26 14:29:06+01:00", 1742995746 * s),
        ("2025-03-26 14:29:06.5+05:30", 1742979546500 * ms),
        ("2025-03-26 14:29:06.5+01", 1742995746500 * ms),  # PostgreSQL
        ("26-Mar-2025 14:29:06", 1742999346 * s),
        ("14:29:60", 52200 * s),
        ("14:29:61", None),
        ("14:29:06:01", None),
        ("20250326 142906", None),
        ("14:29:06:010", None),
        ("29:06.5", None),
        ("29:06", None),
        ("0 days 00:00:01.5", 1500 * ms),  # pandas
        ("1 day, 0:00:01.500000", 86_401_500 * ms),  # Python
        ("-1 days +23:59:59.5", -500 * ms),
        ("999999 days 00:00:00", None),
        ("26.03.25 14:29:06", None),
        ("2025-02-30 10:00:00", None),
        ("2025-13-45 x", None),
        ("2025-03-26 25:00:00", None),
        ("2025-03-26", None),
        ("0999-01-01 00:00:00", None),
    ],
)
def test_other_times_are_read_or_refused(text: str, expected: int | None) -> None:
    assert of_texts(pl.Series([text]), "dmy")[0] == expected


def trace(times: list[object], columns: str = "", name: str = "t", **more: list[object]) -> Part:
    count = np.arange(len(times))
    cells = {"p0": 500 + count % 5, "p1": 500 - count % 7}
    found = Trace({name: times, **cells, **more}, ColumnMap.parse(columns)).part
    assert len(found.touch) == len(times)  # reads it
    return found


@given(
    first=st.integers(1, 99),
    interval=st.integers(200, 20_000),
    clock=st.sampled_from([(2**32, "us"), (2**32, "ms"), (2**16, "ms"), (86_400_000, "ms")]),
)
def test_a_clock_that_wraps_goes_on_with_a_note(first: int, interval: int, clock: tuple[int, str]) -> None:
    span, unit = clock
    interval = interval if unit == "us" else 1 + interval // 1000
    times = [(span - first * interval + k * interval) % span for k in range(200)]
    found = trace([*times], f"units.time={unit}")
    assert np.ptp(np.diff(found.touch.time)) == 0
    assert any("wrapped after row" in each for each in found.notes)


@given(st.lists(st.integers(3, 40), min_size=2, max_size=5))
def test_a_clock_that_starts_again_is_named_and_split_on_request(parts: list[int]) -> None:
    times = [0.02 * k for size in parts for k in range(size)]
    frame = {"t": times, "p0": [*range(500, 500 + len(times))], "p1": [500, *[501] * (len(times) - 1)]}
    with pytest.raises(
        InputError, match=rf"--split makes {len(parts)} sessions \({', '.join(map(str, parts))} rows\)"
    ):
        interpreted(frame)
    found = interpreted(frame, split=True)
    assert [len(each.touch) for each in found] == parts
    assert [each.touch.counts[0, 0] for each in found] == [500 + sum(parts[:k]) for k in range(len(parts))]


@pytest.mark.parametrize("digits", [6, 10])
def test_a_time_without_resolution_is_refused(digits: int) -> None:
    times = [float(f"{1742999346 + k / 100:.{digits}g}") for k in range(240)]
    with pytest.raises(
        InputError, match=r"column t has only \d values? in 240 rows.*: it tells no rate; state time=,rate="
    ):
        trace([*times])
    with pytest.raises(InputError, match=r"; try --map time=,counts=p0,p1,rate=100$"):
        trace([*times], "rate=100")
    assert trace([*times], "time=,rate=100").columns.rate == 100


@given(rate=st.floats(300, 4500))
def test_rows_that_share_whole_milliseconds_keep_their_rate_with_a_warning(rate: float) -> None:
    found = trace([int(1000 * k / rate) for k in range(900)], name="t_ms")
    assert found.columns.rate == pytest.approx(rate, rel=0.01)
    shared = any("share the time of the row before" in each for each in found.warnings)
    assert shared == (rate > 1000) or 990 < rate < 1010


def test_a_time_without_unit_is_refused_if_seconds_are_implausible() -> None:
    with pytest.raises(
        InputError, match=r"column t has no unit, in s its rate is 0.1 Hz; state units.time=ms \(100 Hz\)"
    ):
        trace([10 * k for k in range(60)])
    for unit, step in (("us", 10_000), ("ns", 10_000_000)):  # since boot, and not seconds since 1970
        with pytest.raises(InputError, match=rf"state units.time={unit} \(100 Hz\), or units.time=s; try"):
            trace([1_000_000_000 + step * k for k in range(60)])
    with pytest.raises(InputError, match=r"state another unit \(convert days with polars\), or units.time=s"):
        trace([45742.6 + k / 8_640_000 for k in range(60)])
    with pytest.raises(InputError, match=r"\(if it counts rows\) or .*,rate=ROWS_PER_SECOND,"):
        trace([*range(60)])
    assert trace([10 * k for k in range(60)], "units.time=ms").columns.rate == 100
    assert any(
        "is the time in another unit" in each
        for each in trace([10 * k for k in range(60)], "units.time=s").warnings
    )


@pytest.mark.parametrize(
    ("lost", "rate", "step"),
    [
        (range(500, 520), 100, 1),  # 0.2 s
        (range(0, 1000, 9), 100, 1_000_000),
        (SOME[:50], 100, 1),
        (SOME[:120], 100, 10 * ms),
        (range(500, 580), 400, ms),  # steps of 2 and 3 ms
        (range(500, 640), 700, ms),  # steps of 1 and 2 ms
        (SOME[:50], 1000, ms),
    ],
)
def test_lost_samples_do_not_lower_the_rate_and_are_counted(
    lost: Sequence[int], rate: int, step: int
) -> None:
    given = np.delete(np.arange(1000) * s // rate // step * step, lost)
    found = trace([*given.tolist()], name="time_ns")
    regular = isinstance(lost, range) and lost.step > 1  # like the times of a slower clock
    assert found.columns.rate == pytest.approx(rate * (8 / 9 if regular else 1), rel=0.003)
    warned = [each for each in found.warnings if "samples are missing" in each]
    assert regular or abs(int(warned[0].partition(" ")[0]) - len(lost)) <= 2
    assert trace([*given.tolist()], f"rate={rate}", "time_ns").columns.rate == rate


def test_a_stated_rate_that_the_rows_miss_is_a_warning_only_if_gaps_show_the_loss() -> None:
    lossy = np.delete(np.arange(1000) / 100, SOME[:400])
    found = trace([*lossy.tolist()], "rate=100")
    assert "has 59.96 rows per second, not 100: wrong unit of the time, or lost rows?" in found.warnings
    assert found.columns.rate == 100
    for rate in (60, 90, 112, 190):
        with pytest.raises(InputError, match=rf"has 100 rows per second, not {rate}: wrong unit"):
            trace([k / 100 for k in range(600)], f"rate={rate}")
    assert trace([k / 100 for k in range(600)], "rate=95").columns.rate == 95


def test_times_in_whole_seconds_are_refused_and_bursts_are_no_pauses() -> None:
    with pytest.raises(InputError, match="column t has only 30 values in 3000 rows, 1 s apart: it tells no"):
        trace([k // 100 for k in range(3000)])
    assert trace([30 if 2999 < k < 3031 else k / 100 for k in range(6000)]).columns.rate == pytest.approx(100)
    assert not any("pauses" in each for each in trace([k // 20 / 5 for k in range(1001)]).warnings)


@pytest.mark.parametrize(
    ("rows", "times", "stray"), [((5, 6), (0.06, 0.05), 6), ((5,), (9,), 5), ((5,), (0,), 5)]
)
@pytest.mark.parametrize("split", [False, True])
def test_a_row_out_of_order_is_named(
    rows: tuple[int], times: tuple[float], stray: int, *, split: bool
) -> None:
    frame = {"t": np.arange(60) / 100, "p0": np.arange(60), "p1": np.arange(60)}
    frame["t"][[*rows]] = times
    with pytest.raises(InputError, match=rf"row {stray}, column t: is .*, must be in order: sort the rows"):
        interpreted(frame, split=split)
    frame["t"] = np.arange(60)[::-1] / 100
    with pytest.raises(InputError, match=r"row 1, column t: is 0\.58, must be in order: sort the rows"):
        interpreted(frame, split=split)


def test_the_warnings_of_a_part_are_of_its_own_rows() -> None:
    time = [*(k / 100 for k in range(50)), *(k / 100 + (k > 25) for k in range(50))]
    readings = [*(500 + k % 7 for k in range(20)), -999, *(500 + k % 7 for k in range(79))]
    first, second = interpreted({"t": time, "p0": readings, "p1": [*range(100)]}, split=True)
    assert ["-999" in "".join(each.warnings) for each in (first, second)] == [True, False]
    assert ["pauses: 1" in "".join(each.warnings) for each in (first, second)] == [False, True]
    with pytest.raises(InputError, match="row 50: begins a part without readings: delete the part"):
        interpreted({"t": time, "p0": [*range(50), *[None] * 50]}, ColumnMap.parse("counts=p0"), split=True)


def test_a_date_belongs_to_a_time_of_day_or_is_the_time_itself() -> None:
    clock, day = [dt.time(14, 29, 6 + k // 100, k % 100 * 10_000) for k in range(120)], dt.date(2025, 3, 26)
    midnight, texts = dt.datetime.combine(day, dt.time()), [*map(str, clock)]
    written = f"{day}T14:29:06Z"  # when the row was logged
    for clocks, days in ((clock, [day]), (texts, [midnight]), (texts, [day.isoformat()]), (texts, [written])):
        found = trace([*clocks], Date=[*days] * 120)
        assert (found.columns.columns["date"], found.touch.time[1]) == (("Date",), 1742999346010 * ms)
    seconds = trace([k / 100 for k in range(60)], Date=["2025-03-26"] * 60)
    assert (seconds.columns.rate, "date" in seconds.columns.columns) == (100, False)
    assert trace([f"26.03.2025 {each}" for each in clock], name="Datum").columns.rate == 100


def test_dates_that_may_begin_with_day_or_month_are_refused() -> None:
    times: list[object] = [f"03/04/2025 10:00:{k / 100:05.2f}" for k in range(60)]
    with pytest.raises(InputError, match="may begin with the day or the month; state dates=dmy or dates=mdy"):
        trace(times)
    start = dt.datetime(2025, 3, 4, 10, tzinfo=dt.UTC)
    assert trace(times, "dates=mdy").touch.time[0] == int(start.timestamp()) * s


@pytest.mark.parametrize(
    ("columns", "stated"),
    [
        ({"t": [*range(60)]}, "layout=1x2,range=0:4000"),
        ({"t": ["14:29"] * 60}, "labelled=slip"),
        ({"t": [f"03/04/2025 10:00:{k / 10:04.1f}" for k in range(60)]}, "missing=-7,-8"),
        ({"clock": [k / 100 for k in range(60)]}, "units.time=s"),
        ({"t": [k / 100 for k in range(60)], "label": ["north", "none", "west"] * 20}, "resolution=0.5"),
        ({"p": ["x"] * 60}, "zeroed=true"),
    ],
)
def test_the_map_that_an_error_suggests_reads_the_file_and_keeps_what_was_stated(
    columns: dict[str, list[object]], stated: str
) -> None:
    frame = {**columns, "left": [500 + k % 5 for k in range(60)], "right": [500 - k % 7 for k in range(60)]}
    for _ in range(3):  # of each call, all problems that do not depend on others
        try:
            assert len((found := Trace(frame, ColumnMap.parse(stated)).part).touch) == 60
            break
        except InputError as error:
            [_, suggested] = shlex.split(str(error).rpartition("; try ")[2])
            suggested = suggested.replace("ROWS_PER_SECOND", "100")
            assert {*ColumnMap.parse(stated).stated} <= {*ColumnMap.parse(suggested).stated}
            stated = suggested
    else:
        pytest.fail(f"not read with {stated}")
    assert found.touch.cells == 2
