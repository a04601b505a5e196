"""Rows that come one after the other decode as those of the whole file."""

import csv
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.decoding import Decoder
from connectors.files.text_table import split_line
from operators import Zeroed
from operators.batch import Motion, concat
from operators.errors import InputError, ParameterError
from tests.connectors.files.generated_file import generated, write

NAMES = ["Zeit [us]", "p0 [kPa]", "p1 [kPa]", "v", "Zustand"]
LINES = [
    f"{300_000 + k * 5000};{101 + k % 7 / 100:.2f};{99 - k / 100:.2f};0,{k % 3}5;rutscht" for k in range(200)
]


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    path = tmp_path_factory.mktemp("decoding") / "own.csv"
    path.write_text("\n".join([";".join(NAMES), *LINES, ""]).replace(".", ","))
    return Trace(path)


@given(cuts=st.lists(st.integers(0, 200), max_size=6))
def test_rows_in_any_pieces_give_the_trace(trace: Trace, cuts: list[int]) -> None:
    decoder = Decoder(trace.columns, NAMES, "own.csv")
    rows = [split_line(line.replace(".", ","), ";") for line in LINES]
    parts = [decoder.decode(rows[a:b], a + 2) for a, b in pairwise([0, *sorted(cuts), 200])]
    touch = concat(trace.kind, [part.touch[0] for part in parts])
    assert touch.time.tolist() == trace.touch.time.tolist()
    assert touch.counts.tolist() == trace.touch.counts.tolist()
    motion = concat(Motion, [part.motion for part in parts])
    assert motion.velocity.tolist() == trace.motion.velocity.tolist()
    assert np.concatenate([part.labels for part in parts]).tolist() == trace.labels.tolist()
    assert (decoder.fingertip, decoder.kind) == (trace.fingertip(trace.kind), trace.kind)


def test_the_complete_map_survives_its_file(trace: Trace, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(trace.columns.toml())
    assert ColumnMap.load(str(tmp_path / "own.toml")) == trace.columns


@pytest.mark.parametrize("seed", range(100, 140))
def test_the_complete_map_of_a_file_reads_it_again(seed: int, tmp_path: Path) -> None:
    file = generated(seed)
    path = write(file, tmp_path)
    try:
        rows = len((first := Trace(path, ColumnMap.parse(file.columns))).touch)
    except InputError:
        return
    (tmp_path / "map.toml").write_text(first.columns.toml())
    again = Trace(path, ColumnMap.load(str(tmp_path / "map.toml")))
    assert (len(again.touch), again.columns) == (rows, first.columns)
    assert again.touch.counts.tolist() == first.touch.counts.tolist()
    assert again.touch.time.tolist() == first.touch.time.tolist()


def test_invalid_rows_are_named_all_at_once() -> None:
    decoder = Decoder(ColumnMap.parse("time=t,counts=p0,p1,rate=100,zeroed=true"), ["t", "p0", "p1"], "COM3")
    assert decoder.kind is Zeroed
    with pytest.raises(
        InputError,
        match=r"COM3: has 2 problems: \(1\) line 7, column p0 is 'x', .*\(2\) line 8, column p1 is",
    ):
        decoder.decode([["0.1", "x", "2"], ["0.2", "1", "y"]], 7)
    with pytest.raises(InputError, match="COM3, line 9: has more than 3 fields"):
        decoder.decode([["0.3", "1", "2", "3"]], 9)


def test_a_map_that_is_not_complete_is_refused() -> None:
    with pytest.raises(ParameterError, match="rate is None, must be stated"):
        Decoder(ColumnMap.parse("time=t,counts=p0,p1"), ["t", "p0", "p1"], "COM3")
    with pytest.raises(InputError, match="COM3: there is no column p9; the columns are t p0 p1"):
        Decoder(ColumnMap.parse("time=t,counts=p0,p9,rate=9"), ["t", "p0", "p1"], "COM3")


@given(st.lists(st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1), min_size=1, max_size=5))
def test_a_line_is_split_as_it_is_written(fields: list[str]) -> None:
    import io

    text = io.StringIO()
    csv.writer(text, delimiter=";").writerow(fields)
    assert split_line(text.getvalue(), ";") == fields
