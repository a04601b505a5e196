"""CSV files of any dialect."""

import csv
import gzip
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from connectors import Trace
from connectors.files.container import read_table
from connectors.files.csv_table import SEPARATORS
from operators.errors import InputError

Write = Callable[[str], Path]
NAMES = "t", "p0", "p1"


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_text(text: str) -> Path:
        path = tmp_path / "trace.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return write_text


@pytest.mark.parametrize(("sign", "separator"), SEPARATORS.items())
def test_the_separator_is_detected(write: Write, sign: str, separator: str) -> None:
    path = write("\n".join(sign.join(row) for row in (NAMES, ("0.5", "1.5", "-2"), ("0.6", "3", "4"))) + "\n")
    table = read_table(path)
    assert table.header.names == NAMES
    assert table.reals("p0").tolist() == [1.5, 3]
    assert table.notes == (() if separator == "comma" else (f"separator {separator}",))


@given(
    st.sampled_from([*SEPARATORS]),
    st.lists(
        st.tuples(*[st.floats(-1e6, 1e6).map(lambda value: round(value, 3))] * 3), min_size=1, max_size=9
    ),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_numbers_are_read_with_any_separator(
    write: Write, sign: str, rows: list[tuple[float, float, float]]
) -> None:
    text = io.StringIO()
    writer = csv.writer(text, delimiter=sign)
    writer.writerows([NAMES, *rows])
    table = read_table(write(text.getvalue()))
    assert [table.reals(name).tolist() for name in NAMES] == [
        list(column) for column in zip(*rows, strict=True)
    ]


def test_a_decimal_comma_is_read_unless_the_comma_separates(write: Write) -> None:
    table = read_table(write("t;p0;p1\n0,01;1013,25;-,5\n0,02;1e2;7\n"))
    assert table.notes == ("separator semicolon", "decimal comma")
    assert table.times("t", "s").tolist() == [10_000_000, 20_000_000]
    assert table.reals("p0").tolist() == [1013.25, 100]
    assert table.reals("p1").tolist() == [-0.5, 7]


def test_columns_may_be_aligned_with_spaces_and_tabs(write: Write) -> None:
    table = read_table(write("   t      p0\t p1\n\n 0.01    1      2\n 0.02   10     20  \n"))
    assert table.reals("p1").tolist() == [2, 20]
    with pytest.raises(InputError, match="line 4, column p0: is 'x', must be a number"):
        read_table(write("   t      p0\t p1\n\n 0.01    1      2\n 0.02   x     20  \n")).reals("p0")


def test_comments_above_the_names_are_skipped(write: Write) -> None:
    table = read_table(write("# a sensor\n# 2026\nt,p0,p1\n1,2,3\n2,x,5\n"))
    assert table.header.names == NAMES
    with pytest.raises(InputError, match="line 5, column p0: is 'x'"):
        table.reals("p0")


def test_names_may_have_quotation_marks(write: Write) -> None:
    assert read_table(write('t,"2"" pad"\n0.01,1\n')).header.names == ("t", '2" pad')
    with pytest.raises(InputError, match='line 1: has a quoted name that is not closed: write "" for a "'):
        read_table(write('t,2" pad\n0.01,1\n'))


def test_a_file_of_many_values_is_refused_before_they_fill_the_memory(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("connectors.files.trace_table.VALUES", 1 << 20)
    for sign in ",", " ":
        line = sign.join(("1", "2", "3")) + "\n"
        assert len(read_table(write(line.replace("1", "t") + line * 300_000))) == 300_000
        with pytest.raises(
            InputError, match="has more than 1 million values, the limit: split it into several files"
        ):
            read_table(write(line.replace("1", "t") + line * 350_000))


def test_a_gzipped_file_is_read_up_to_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "trace.csv.gz"
    path.write_bytes(gzip.compress(b"t,p0,p1\n1,2,3\n"))
    assert read_table(path).reals("p1").tolist() == [3]
    monkeypatch.setattr("connectors.files.trace_table.LIMIT", 1 << 20)
    path.write_bytes(gzip.compress(b"t,p0,p1\n" + b"1,2,3\n" * (1 << 18)))
    assert path.stat().st_size < 1 << 14
    with pytest.raises(InputError, match="is larger than 1 MiB, the limit: split it into several files"):
        read_table(path)
    packed = path.read_bytes()
    for damaged in (packed[:100], packed[:20] + bytes(20) + packed[40:]):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="is a damaged gzip file"):
            read_table(path)
    path.write_bytes(b"\x28\xb5\x2f\xfd" + bytes(20))
    with pytest.raises(InputError, match="is compressed: decompress it first, or use gzip"):
        read_table(path)


def test_a_table_of_very_many_columns_is_refused_at_once(write: Write) -> None:
    with pytest.raises(InputError, match="has more than 4096 columns"):
        read_table(write(",".join(map(str, range(20_000))) + "\n" + "1," * 19_999 + "1\n"))


def test_a_line_that_is_cut_off_is_refused(write: Write) -> None:
    with pytest.raises(
        InputError, match="the last line has fewer fields than line 1 has names: it is cut off"
    ):
        read_table(write("t,p0,p1\n1,2,3\n2,3"))


def test_a_last_line_that_ends_with_an_empty_field_is_complete(write: Write) -> None:
    for end in ("", "\n", "\r\n\r\n", "\n \n"):
        assert np.isnan(read_table(write(f"t\tp0\tp1\n1\t2\t3\n2\t3\t{end}")).reals("p1")).tolist()[:2] == [
            False,
            True,
        ]


def test_a_byte_order_mark_is_skipped(write: Write) -> None:
    assert read_table(write("\ufefft,p0\n0.5,7\n")).header.names == ("t", "p0")
    assert read_table(write("\ufeff# a rig\nt,p0\n0.5,7\n")).header.names == ("t", "p0")


def test_utf_16_is_refused_with_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    path.write_text("t\tp0\n0.5\t7\n", encoding="utf-16")
    with pytest.raises(InputError, match="is UTF-16: save it as UTF-8"):
        read_table(path)


def test_times_may_be_dates(write: Write) -> None:
    for sign in "T", " ":
        for point in ".", ",":
            rows = (f'"2026-11-23{sign}15:00:00{point}{digits}",1,2\n' for digits in ("250", "260"))
            trace = Trace(write("t,p0,p1\n" + "".join(rows)))
            assert trace.touch.time.tolist() == [1795446000250000000, 1795446000260000000]


@pytest.mark.parametrize("date", ["2026-13-45 x", "2026-11-23 25:00:00", "2026-11-23 soon"])
def test_an_invalid_date_is_named_by_line_and_column(write: Write, date: str) -> None:
    for rows, line in (([date, date], 2), (["2026-11-23 15:00:00", date], 3)):
        path = write("t,p0,p1\n" + "".join(f"{each},1,2\n" for each in rows))
        with pytest.raises(InputError, match=f"line {line}, column t: is '{date}', must be a time in s"):
            Trace(path)


@given(st.binary(max_size=300))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_content_is_a_table_or_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "any.csv").write_bytes(content)
    try:
        read = len(read_table(tmp_path / "any.csv")) > 0
    except InputError as error:
        read = "\n" not in str(error)
    assert read
