"""A complete map reads its file again, at once or line by line."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.line_decoder import LineDecoder
from connectors.files.text_table import split_line
from operators.batch import concat
from operators.errors import InputError
from tests.connectors.files.generated_file import generated, write


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


@pytest.mark.parametrize("seed", range(200, 260))
def test_lines_have_the_formats_of_files(seed: int, tmp_path: Path) -> None:
    file = generated(seed)
    path = write(file, tmp_path)
    try:
        whole = Trace(path, ColumnMap.parse(file.columns)).touch
    except InputError:
        return
    if file.refusable or path.suffix == ".gz" or "parquet" in file.about:
        return
    trace = Trace(path, ColumnMap.parse(file.columns))
    data = file.content.decode("cp1252" if "Windows-1252" in trace.notes else "utf-8").encode()
    counted = dict.fromkeys(["lines", "damaged", "restarts"], 0)
    decoder = LineDecoder("logger", trace.columns, (), counted)
    cuts = np.random.default_rng(seed).integers(0, len(data), 9)
    pieces = np.split(np.frombuffer(data, np.uint8), np.sort(cuts))
    rows = [touch for each in pieces for touch in decoder.feed(each.tobytes(), 10**18)]
    found = concat(trace.kind, rows)
    assert found.counts.tolist() == whole.counts.tolist(), file.about
    assert found.valid.tolist() == whole.valid.tolist(), file.about


@given(st.lists(st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1), min_size=1, max_size=5))
def test_a_line_is_split_as_it_is_written(fields: list[str]) -> None:
    text = io.StringIO()
    csv.writer(text, delimiter=";").writerow(fields)
    assert split_line(text.getvalue(), ";") == fields
