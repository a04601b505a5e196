"""CSV files of any dialect."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.container import read_table
from connectors.files.number_format import reals, with_decimal
from operators.errors import InputError
from tests.connectors.files.conftest import Write


def read(path: Path) -> dict[str, list[float]]:
    """Return the columns of a file as numbers."""
    table = read_table(path)
    sign = with_decimal(table, ColumnMap({"counts": tuple(table.columns)})).decimal_sign
    table.stop()
    return {name: reals(column, sign).to_list() for name, column in table.columns.items()}


def test_columns_may_be_aligned_with_spaces_and_tabs(write: Write) -> None:
    assert read(write("   t      p0\t p1\n\n 0.01    1      2\n 0.02   10     20  \n"))["p1"] == [2, 20]


BODY = "0.00,500,501\n0.01,502,503\n"
EXPECTED = {"t": [0, 0.01], "p0": [500, 502], "p1": [501, 503]}


@pytest.mark.parametrize(
    ("content", "names", "first"),
    [
        (f"# 2026\n# t,p0,p1\n{BODY}", "t p0 p1", 3),  # numpy.savetxt
        (f"t,0,1\n{BODY}", "t 0 1", 2),
        (f"Recording,stroke 3\nRate [Hz],100\n\nt,p0,p1\n{BODY}", "t p0 p1", 5),
        (f"A title\nt,p0,p1\ns,kPa,kPa\n{BODY}", "t p0 p1", 4),
        (BODY, "column1 column2 column3", 1),
        ("t,p0,p1\n" + BODY.replace("\n", ",\n"), "t p0 p1", 2),
        (f"t,p0,p1\n\n{BODY}\n\n", "t p0 p1", 3),
        (f"t,p0,p1\n{BODY[:13]}t,p0,p1\n{BODY[13:]}", "t p0 p1", 2),  # a logger that started again
        (f"\ufeff# a rig\nt,p0,p1\n{BODY}", "t p0 p1", 3),
        (f"Log,of,of\nt,p0,p1\n{BODY}", "t p0 p1", 3),
    ],
)
def test_a_table_is_found_below_other_lines(write: Write, content: str, names: str, first: int) -> None:
    path = write(content)
    assert dict(zip(names.split(), EXPECTED.values(), strict=True)) == read(path)
    assert read_table(path).numbers[0] == first


def test_lines_that_are_left_out_are_counted(write: Write) -> None:
    table = read_table(write(f"t,p0,p1\n{BODY}\n,,\nt,p0,p1\n{BODY}", end=""))
    assert table.numbers.tolist() == [2, 3, 7, 8]
    assert table.notes == ["left out 3 lines without values, or with the names again"]


@pytest.mark.parametrize("units", ["[s],[kPa],[-]", "s,kPa,-", "(s), (kPa), ", "<s>,{kPa},[ - ]"])
def test_a_row_of_units_is_not_a_row_of_values(write: Write, units: str) -> None:
    found = read_table(write(f"t,p0,p1\n{units}\n{BODY}")).units
    assert (found["t"], found["p0"], found["p1"].strip("-")) == ("s", "kPa", "")
    for first in ("", "0.00,<NA>,<NA>\n", "14:29,ERR,ERR\n"):
        assert read_table(write(f"t,p0,p1\n{first}{BODY}")).units == {}


def test_an_unknown_unit_matters_only_if_its_column_is_used(write: Write) -> None:
    text = "t,p0,p1,temp,speed\nms,kPa,kPa,\u00b0C,rad/s\n0,500,501,20,1\n10,500,501,20,1\n"
    path = write(text)
    assert Trace(path, ColumnMap.parse("speed=")).part.columns.unit == "kPa"
    reason = "unit rad/s of column speed must be m/s or cm/s or mm/s: state units.speed=..., or convert it"
    with pytest.raises(InputError, match=reason):
        _ = Trace(path).part
    assert list(read_table(write(f"A title\nms,N,slip\n{BODY}")).columns) == ["ms", "N", "slip"]
    assert Trace(write(f"t,p0,p1\ns,inH2O,inH2O\n{BODY}")).part.columns.unit == "inH2O"
    with pytest.raises(InputError, match="column p0 is a temperature, not a cell"):
        _ = Trace(write(f"t,p0,p1\ns,degC,degC\n{BODY}")).part


def test_windows_1252_is_read(tmp_path: Path) -> None:
    (tmp_path / "trace.csv").write_bytes("time [\u00b5s],p0,p1\n".encode("cp1252") + BODY.encode())
    table = read_table(tmp_path / "trace.csv")
    assert (list(table.columns), table.notes) == (["time [\u00b5s]", "p0", "p1"], ["Windows-1252"])
    (tmp_path / "trace.csv").write_bytes(BODY.encode("utf-16"))
    with pytest.raises(InputError, match="is text in UTF-16: save it as UTF-8"):
        read_table(tmp_path / "trace.csv")


def test_names_may_have_quotation_marks(write: Write) -> None:
    assert [*read_table(write('t,"2"" pad"\n0.01,1\n')).columns] == ["t", '2" pad']
    assert [*read_table(write('t,2" pad\n0.01,1\n')).columns] == ["t", '2" pad']


def test_a_file_of_many_values_is_refused_before_they_fill_the_memory(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("connectors.files.raw_table.VALUES", 1 << 20)
    for sign in ",", " ":
        line = sign.join(("1", "2", "3")) + "\n"
        assert len(read_table(write(line.replace("1", "t") + line * 300_000))) == 300_000
        with pytest.raises(InputError, match="has more than 1 million values, the limit: split it into"):
            read_table(write(line.replace("1", "t") + line * 350_000))


def test_a_gzipped_file_is_read_up_to_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "trace.csv.gz"
    path.write_bytes(gzip.compress(b"t,p0,p1\n1,2,3\n"))
    assert read(path)["p1"] == [3]
    monkeypatch.setattr("connectors.files.container.LIMIT", 1 << 20)
    path.write_bytes(gzip.compress(b"t,p0,p1\n" + b"1,2,3\n" * (1 << 18)))
    assert path.stat().st_size < 1 << 14
    with pytest.raises(InputError, match="unpacks to more than 1 MiB, the limit: split it into files"):
        read_table(path)
    packed = path.read_bytes()
    for damaged in (packed[:100], packed[:20] + bytes(20) + packed[40:]):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="is a damaged gzip file"):
            read_table(path)


def test_a_table_of_very_many_columns_is_refused_at_once(write: Write) -> None:
    with pytest.raises(InputError, match="has more than 4096 columns"):
        read_table(write(",".join(map(str, range(20_000))) + "\n" + "1," * 19_999 + "1\n"))
    with pytest.raises(InputError, match="has a line of more than 1 MiB"):
        read_table(write("1" * (1 << 21)))


def test_a_last_line_that_ends_with_an_empty_field_is_complete(write: Write) -> None:
    for end in ("", "\n", "\r\n\r\n", "\n \n"):
        assert np.isnan(read(write(f"t\tp0\tp1\n1\t2\t3\n2\t3\t{end}", end=""))["p1"]).tolist()[:2] == [
            False,
            True,
        ]


def test_numbers_between_blanks_in_a_text_do_not_hide_the_commas(write: Write) -> None:
    rows = "".join(f"{k / 100},5{k},6{k},pad 2 10 N\n" for k in range(50))
    assert list(read_table(write(f"t,p0,p1,note\n{rows}")).columns) == ["t", "p0", "p1", "note"]
