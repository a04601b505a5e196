"""Files of many formats give the values that they were made of, or an error; never others."""

from pathlib import Path

import numpy as np
import pytest

from connectors import Trace
from connectors.files.column_map import ColumnMap
from operators.errors import InputError, ParameterError
from tests.connectors.files.generated_file import generated, write


def check(seed: int, folder: Path) -> bool:
    """Compare a file with its values; return True if it was read."""
    file = generated(seed)
    path, about = write(file, folder), f"seed {seed}: {', '.join(file.about)}"
    try:
        rows = len((trace := Trace(path, ColumnMap.parse(file.columns)).part).touch)
    except (InputError, ParameterError) as error:
        text = str(error)
        good = file.refusable and text.startswith(str(path)) and "\n" not in text
        return False if good else pytest.fail(f"{about}: {text}")
    assert rows == len(file.time) or file.refusable, about
    assert trace.columns.unit == file.unit, about
    if "the last line has no end: was it cut off?" in trace.notes:
        rows -= 1
    shift = trace.touch.time[0] - file.time[0] if file.time[0] < 10**18 else 0  # of a device's clock
    assert np.abs(trace.touch.time[:rows] - file.time[:rows] - shift).max() <= 2 * file.tolerance + 1, about
    given = (trace.touch.counts[:rows] + trace.offset) * trace.resolution
    wrong = np.abs(given - file.readings[:rows]) > 0.51 * trace.resolution
    assert not (wrong & trace.touch.valid[:rows]).any(), about
    assert trace.touch.valid.all() or trace.warnings, about
    assert trace.labels[:rows].tolist() == file.labels[:rows], about
    return True


@pytest.mark.parametrize("first", range(0, 60, 10))
def test_a_file_gives_its_values_or_an_error(first: int, tmp_path: Path) -> None:
    assert sum(check(seed, tmp_path) for seed in range(first, first + 10)) >= 5


@pytest.mark.slow
def test_five_hundred_files_give_their_values_or_an_error(tmp_path: Path) -> None:
    assert sum(check(seed, tmp_path) for seed in range(1000, 1500)) > 300
