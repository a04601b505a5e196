"""Columns of a CSV trace."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.files.column_map import ColumnMap, Header
from operators.errors import InputError, ParameterError

CELLS = ("s1", "s2", "s3", "s4", "s5", "s6")


def test_a_map_has_lists_ranges_and_units() -> None:
    found = ColumnMap.parse("time=my t, counts=a,b,c3..c1,d,label=,speed = v", "time=ms,speed=mm/s")
    assert found.columns == {
        "time": ("my t",),
        "counts": ("a", "b", "c3", "c2", "c1", "d"),
        "label": (),
        "speed": ("v",),
    }
    assert (found.scale("time"), found.scale("speed")) == (1e6, 0.001)


def test_a_printed_map_can_be_parsed() -> None:
    found = ColumnMap.parse("time=t,counts=p0..p5,velocity=vx,vy,vz")
    assert ColumnMap.parse(str(found)) == found


@pytest.mark.parametrize(
    ("columns", "units", "complaint"),
    [
        ("t", "", "columns is 't', must be written as time=t"),
        ("force=f", "", "quantity is 'force', must be one of time, counts"),
        ("counts=p0..p127,p128", "", "must be 1 to 128 column names"),
        ("velocity=a,b", "", "velocity is 'a,b', must be 3 or 6 column names"),
        ("counts=p0..q5", "", "range of columns is 'p0..q5', must be of one name"),
        ("counts=p0..p99999999999", "", "must be of 128 columns at most"),
        ("speed=v,velocity=x,y,z", "", "speed is 'v', must be omitted, since velocity is given"),
        (
            "",
            "label=s",
            "quantity with a unit is 'label', must be one of time, counts, velocity, speed, joint",
        ),
        ("", "time=min", "unit of time is 'min', must be one of s, ms, us, ns"),
        ("", "speed=", "unit of speed is '', must be one of m/s"),
        ("", "counts=kpa", "unit of counts is 'kpa', must be one of count, Pa, hPa, mbar, kPa"),
        ("", "counts=Pa:N", "unit of counts is 'Pa:N', must be two units of one quantity"),
        ("joint=w", "", "lever is None, must be the distance from the joint's axis to the fingertip, m"),
        ("joint=w,speed=v", "", "joint is 'w', must be omitted, since speed is given"),
    ],
)
def test_an_invalid_map_is_refused(columns: str, units: str, complaint: str) -> None:
    with pytest.raises(ParameterError) as caught:
        ColumnMap.parse(columns, units)
    assert complaint in str(caught.value)


@given(st.text(alphabet="tc=,.0123456789p ", max_size=30))
def test_any_text_is_a_map_or_refused(text: str) -> None:
    with suppress(ParameterError):
        found = ColumnMap.parse(text)
        assert all(len(columns) in (0, 1, 3, 6) for columns in found.columns.values())


@pytest.mark.parametrize(
    ("names", "held"),
    [
        (("Time", *CELLS), {"time": ("Time",), "counts": CELLS}),
        (
            ("t_ms", *(f"P{i}" for i in range(6))),
            {"time": ("t_ms",), "counts": ("P0", "P1", "P2", "P3", "P4", "P5")},
        ),
        (("t", *CELLS, "Slip", "v", "other"), {"label": ("Slip",), "speed": ("v",)}),
        (("t", *CELLS, "vx", "vy", "vz", "v"), {"velocity": ("vx", "vy", "vz")}),
        (("t", *CELLS, "vx", "vy", "v"), {"speed": ("v",)}),
    ],
)
def test_usual_names_are_recognised(names: tuple[str, ...], held: dict[str, tuple[str, ...]]) -> None:
    found = ColumnMap().completed(Header(names, "line 1")).columns
    assert held.items() <= found.items()
    assert not {"velocity", "speed"} <= set(found)


@pytest.mark.parametrize("cells", [1, 2, 7, 16, 64])
def test_numbered_columns_are_the_cells_of_a_fingertip(cells: int) -> None:
    for first in (0, 1):
        names = tuple(f"taxel{number}" for number in range(first, first + cells))
        assert ColumnMap().completed(Header(("t", *names[::-1]), "line 1")).columns["counts"] == names


def test_one_numbered_column_is_a_cell_only_if_no_other_columns_are() -> None:
    assert ColumnMap().completed(Header(("t", "b1", *CELLS))).columns["counts"] == CELLS
    with pytest.raises(InputError, match="several candidates for counts: 'b1' or 's1'"):
        ColumnMap().completed(Header(("t", "b1", "s1")))


@pytest.mark.parametrize("names", [("s2",), ("s1", "s3"), ("s2", "s3"), ("left", "right")])
def test_other_columns_are_no_fingertip(names: tuple[str, ...]) -> None:
    with pytest.raises(
        InputError, match=r"none recognised as counts; map it .*ColumnMap.* or counts=left,right,"
    ):
        ColumnMap().completed(Header(("t", *names), "line 1"))


@pytest.mark.parametrize(
    ("names", "complaint"),
    [
        (
            ("t", "time", *CELLS),
            "for time: 't' or 'time'; map it (import --map, ColumnMap.parse), for example time=t",
        ),
        (
            ("t", *CELLS, *(f"c{i}" for i in range(6))),
            "has several candidates for counts: 's1 s2 s3 s4 s5 s6' or 'c0 c1",
        ),
        (("t", *CELLS, "label", "slip"), "has several candidates for label: 'label' or 'slip'"),
    ],
)
def test_an_ambiguous_column_is_refused(names: tuple[str, ...], complaint: str) -> None:
    with pytest.raises(InputError) as caught:
        ColumnMap().completed(Header(names, "line 1"))
    assert complaint in str(caught.value)


def test_a_pattern_stands_for_all_matching_columns_in_the_order_of_their_numbers() -> None:
    header = Header(("t", "w", *(f"e{number}" for number in range(19, 0, -1))))
    found = ColumnMap.parse("counts=e*,joint=w", lever=0.1).completed(header)
    assert found.columns["counts"] == tuple(f"e{number}" for number in range(1, 20))
    assert ColumnMap.parse("counts=e1*").completed(header).columns["counts"] == (
        "e1",
        *(f"e{number}" for number in range(10, 20)),
    )
    with pytest.raises(InputError, match=r"none of which matches x\*"):
        ColumnMap.parse("counts=x*").completed(header)
    with pytest.raises(ParameterError, match=r"velocity is .*, must be 3 or 6 column names"):
        ColumnMap.parse("velocity=e*").completed(header)
    with pytest.raises(InputError, match="column e1 cannot be two cells"):
        ColumnMap.parse("counts=e*,e1").completed(header)


@pytest.mark.parametrize(
    ("names", "units"),
    [
        (("t", *(f"p{cell}_kPa" for cell in range(4))), {"time": "s", "counts": "kPa"}),
        (("time [ms]", "cell 1 (N)", "cell 2 (N)"), {"time": "ms", "counts": "N"}),
        (("Time_us", "b0", "b1", "speed [mm/s]"), {"time": "us", "counts": "count", "speed": "mm/s"}),
    ],
)
def test_units_are_read_from_the_names(names: tuple[str, ...], units: dict[str, str]) -> None:
    assert ColumnMap().completed(Header(names)).units == units


@pytest.mark.parametrize(
    ("unit", "scale", "units"),
    [
        ("kPa", 1.0, ("kPa", "kPa")),
        ("Pa:kPa", 0.001, ("Pa", "kPa")),
        ("mbar:hPa", 1.0, ("mbar", "hPa")),
        ("volts:mV", 1000.0, ("V", "mV")),
    ],
)
def test_cells_are_converted_on_request_only(unit: str, scale: float, units: tuple[str, str]) -> None:
    found = ColumnMap.parse(units=f"counts={unit}")
    assert found.scale("counts") == pytest.approx(scale)
    assert found.cell_units == units


def test_mapped_columns_are_not_recognised_by_name() -> None:
    names = ("t", "time_ns", *CELLS, "label", "slip", "v")
    said = ColumnMap.parse("time=time_ns,label=,velocity=s1,s2,s3")
    found = said.completed(Header(names, "line 1"))
    assert found.columns == {"time": ("time_ns",), "counts": CELLS, "velocity": ("s1", "s2", "s3")}
    assert found.units == {"time": "ns", "counts": "count", "velocity": "m/s"}
