"""Layout and range of a fingertip, stated for its file."""

from pathlib import Path

import pytest

from connectors import Trace
from connectors.files.column_map import ColumnMap
from connectors.files.pad import Pad, layout_text
from operators import FingertipError, Pool, Touch
from operators.errors import ParameterError
from operators.fingertip import TAKKTILE, Fingertip


def described(folder: Path, pad: Pad, units: str = "", cells: int = 4, base: float = 100) -> Fingertip:
    path = folder / "pad.csv"
    rows = [f"{k / 100},{','.join(f'{base + 10 * cell + k % 7}' for cell in range(cells))}" for k in range(9)]
    path.write_text("\n".join([f"t,{','.join(f'c{cell}' for cell in range(cells))}", *rows]))
    found = Trace(path, ColumnMap.parse(units=units), pad=pad).fingertip(Touch)
    assert found is not None
    return found


def test_a_fingertip_has_the_stated_layout_and_range(tmp_path: Path) -> None:
    found = described(tmp_path, Pad.parse("4x1", "0:4000"))
    assert (found.layout, found.range, found.falls) == (((0,), (1,), (2,), (3,)), (0, 4000), False)
    found = described(tmp_path, Pad.parse("3, 2, 1/-1, 0, -1", "4095:0"))
    assert (found.layout, found.falls) == (((3, 2, 1), (-1, 0, -1)), True)


def test_without_a_statement_layout_and_range_are_as_before(tmp_path: Path) -> None:
    found = described(tmp_path, Pad.parse())
    assert (found.layout, found.range, found.falls) == (((0, 1), (2, 3)), None, None)


def test_a_range_in_the_unit_of_the_file_becomes_counts(tmp_path: Path) -> None:
    found = described(tmp_path, Pad.parse(range="1:20"), "counts=Pa:kPa")
    assert (found.unit, found.resolution, found.range) == ("kPa", 0.001, (1, 20))
    found = described(tmp_path, Pad.parse(range="0:1e9"))
    assert found.range == (0, 32767)  # as counts


def test_a_range_is_relative_to_the_offsets_of_the_cells(tmp_path: Path) -> None:
    found = described(tmp_path, Pad.parse(range="100000:101000"), "counts=Pa", base=100_000)
    assert found.range is not None
    assert (found.resolution, found.range[1] - found.range[0]) == (1, 1000)
    assert abs(found.range[0]) < 32767


def test_rising_counts_of_six_cells_are_refused_by_a_detector_for_falling_ones(tmp_path: Path) -> None:
    rising = described(tmp_path, Pad.parse(range="0:4000"), cells=6)
    with pytest.raises(FingertipError, match=r"needs .*falling as pressure rises; .* Pool\(gain=-1\)"):
        TAKKTILE.check_fits("tcn", rising)
    TAKKTILE.check_fits("tcn", Pool(gain=-1).output_fingertip(rising))


@pytest.mark.parametrize(
    ("layout", "limits", "complaint"),
    [
        ("wide", "", "layout is 'wide', must be ROWSxCOLUMNS such as 8x2"),
        ("0x4", "", "at most 128 cells"),
        ("64x64", "", "at most 128 cells"),
        ("3x3", "", "layout is '0,1,2/3,4,5/6,7,8', must be of 4 cells"),
        ("0,1/2,2", "", "must be rows that name each cell from 0 on once"),
        ("", "4000", "range is '4000', must be LOW:HIGH"),
        ("", "0:nan:1", "range is '0:nan:1', must be LOW:HIGH"),
        ("", "0:nan", "range is '0:nan', must be LOW:HIGH"),
        ("", "5:5", "must be two different counts"),
    ],
)
def test_an_invalid_statement_is_refused(tmp_path: Path, layout: str, limits: str, complaint: str) -> None:
    with pytest.raises(ParameterError) as caught:
        described(tmp_path, Pad.parse(layout, limits))
    assert complaint in str(caught.value)


def test_a_layout_that_is_printed_can_be_parsed() -> None:
    layout = ((5, 4, 3), (0, -1, 1), (2,))
    assert Pad.parse(layout_text(layout)).layout == layout
