"""Roles, units and layouts by the names of columns."""

import re
import shlex
from collections.abc import Sequence

import polars as pl
import pytest

from connectors.files.column_map import ColumnMap
from connectors.files.raw_table import RawTable
from connectors.files.roles import completed, unit_in
from operators.errors import InputError

CELLS = ("s1", "s2", "s3", "s4", "s5", "s6")
DRUCK = tuple(f"druck_{k}" for k in range(1, 11))
UR = tuple(f"actual_TCP_speed_{number}" for number in range(6))  # as RTDE names them
ROS = tuple(f"twist.{kind}.{axis}" for kind in ("linear", "angular") for axis in "xyz")


def roles(names: Sequence[str], columns: str = "") -> ColumnMap:
    """Return the completed map of a table with these names."""
    table = RawTable.of(pl.DataFrame({name: ["1"] for name in names}), "pad")
    found = completed(table, ColumnMap.parse(columns))
    table.stop()
    return found


@pytest.mark.parametrize(
    ("names", "held"),
    [
        (("Time", *CELLS), {"time": ("Time",), "counts": CELLS}),
        (
            ("Zeit [s]", *(f"P{i}" for i in range(6))),
            {"time": ("Zeit [s]",), "counts": ("P0", "P1", "P2", "P3", "P4", "P5")},
        ),
        (("t", *CELLS, "Slip", "v", "other"), {"label": ("Slip",), "speed": ("v",)}),
        (("t", *CELLS, "vx", "vy", "vz", "v"), {"velocity": ("vx", "vy", "vz")}),
        (("t", *CELLS, "vx", "vy", "v", "V"), {"speed": ("v",)}),  # V are volts
        # T is a temperature, b1 alone no fingertip
        (("t", "T", *CELLS, "b1"), {"time": ("t",), "counts": CELLS}),
        (
            ("t", *CELLS, *(f"v{axis} [mm/s]" for axis in "xyz")),
            {"velocity": ("vx [mm/s]", "vy [mm/s]", "vz [mm/s]")},
        ),
        (("t", *CELLS, "v [V]", "speed (left)", "temps", "Tempo"), {"time": ("t",), "counts": CELLS}),
        (
            ("t", *CELLS, *("vx", "vy", "vz"), *(f"w{axis} [deg/s]" for axis in "xyz")),
            {"velocity": ("vx", "vy", "vz")},
        ),
        (("t", "druck_2", "druck_10", *(f"druck_{k}" for k in range(3, 10)), "druck_1"), {"counts": DRUCK}),
        (("t", *CELLS, *UR), {"velocity": UR}),
        (("t", *CELLS, *ROS), {"velocity": ROS}),
        (("t", *CELLS, "TCP_vx", "TCP_vy", "TCP_vz"), {"velocity": ("TCP_vx", "TCP_vy", "TCP_vz")}),
        (("t", *(f"taxel[{k},1]" for k in range(3))), {"counts": ("taxel[0,1]", "taxel[1,1]", "taxel[2,1]")}),
        (("t", *(f"b{i}_{what}" for i in range(3) for what in "PT")), {"counts": ("b0_P", "b1_P", "b2_P")}),
        (("t", "p0 [kPa]", "p1 [kPa]", "T0 [degC]", "T1 [degC]"), {"counts": ("p0 [kPa]", "p1 [kPa]")}),
        (("t", "s", "s1", "s2"), {"counts": ("s1", "s2")}),
    ],
)
def test_usual_names_are_recognised(names: tuple[str, ...], held: dict[str, tuple[str, ...]]) -> None:
    found = roles(names).columns
    assert held.items() <= found.items()
    assert not {"velocity", "speed"} <= set(found)


@pytest.mark.parametrize("name", ["taxel_{}_{}", "taxel_{}_{} [kPa]", "cell{}x{}", "p[{}][{}]", "s{},{}"])
def test_names_of_row_and_column_give_the_layout(name: str) -> None:
    names = [name.format(row, column) for row in range(2) for column in range(3)]
    found = roles(("t", *sorted(names, key=hash)))
    assert (found.columns["counts"], found.layout) == (tuple(names), ((0, 1, 2), (3, 4, 5)))
    assert roles(("t", *names), "layout=3x2").layout == ((0, 1), (2, 3), (4, 5))


@pytest.mark.parametrize(
    ("names", "counts"),
    [
        *(((name,), name) for name in ("s2", "s1,s3", "s2,s3", "left,right")),
        *((names, "NAME,NAME") for names in (("b0_T", "b1_T"), ("temp0", "temp1"), ("s0 [C]", "s1 [C]"))),
        (tuple(f"p{k}" for k in range(129)), "NAME,NAME"),  # more than a fingertip has
        (tuple(f"{row}{k}" for row in "ABC" for k in (1, 2)), "NAME,NAME"),  # one row, or all?
        (("tip, kPa", "side, kPa"), "tip? kPa,side? kPa"),
        *((tuple(names.split(",")), names) for names in ("p,p.1,p.2", "p,p_1")),  # p may be their sum
        (("p [kPa]", "p 1 [kPa]"), "p [kPa],p 1 [kPa]"),
    ],
)
def test_other_columns_are_no_fingertip(names: tuple[str, ...], counts: str) -> None:
    names = tuple(counts.split(",")) if names == (counts,) else names
    with pytest.raises(InputError) as caught:
        roles(("t", *names))
    [_, suggested] = shlex.split(str(caught.value).rpartition("; try ")[2])
    assert suggested == f"time=t,counts={counts}"
    if "NAME" not in counts:
        assert roles(("t", *names), suggested).cell_names == [*names]


def test_a_temperature_is_no_cell_even_if_it_is_mapped() -> None:
    with pytest.raises(InputError, match="column b0_T is a temperature, not a cell"):
        roles(("t", "b0_T", "b1_T"), "counts=b0_T..b1_T")
    assert roles(("t", "h0_T", "h1_T"), "counts=h0_T..h1_T,units.counts=mT").unit == "mT"


@pytest.mark.parametrize(
    ("names", "complaint"),
    [
        (
            ("t1", "time", "stamp", *CELLS),
            "columns time and stamp may be time; state one, as time=time; try --map time=",
        ),
        (("time", "t", *CELLS), "columns time and t may be time; state one, as time=time"),
        (
            ("t", *CELLS, *(f"c{i}" for i in range(6))),
            "may be the cells; state counts=..., or of 2 fingertips counts.0=s1..s6,counts.1=c0..c5",
        ),
        (("t", *CELLS, "label", "slip"), "columns label and slip may be label; state one, as label=label"),
        (
            ("t", "time", "vx", "vy", "vz", "speed", "left", "right"),
            "try --map time=t,velocity=vx,vy,vz,counts=left,right",
        ),
        (("t", "L2", "L1", "R2", "R1"), "try --map time=t,counts.0=L1,L2,counts.1=R1,R2"),
    ],
)
def test_an_error_lists_all_problems_with_a_map_of_the_columns(
    names: tuple[str, ...], complaint: str
) -> None:
    with pytest.raises(InputError) as caught:
        roles(names)
    assert complaint in str(caught.value)


@pytest.mark.parametrize(
    ("names", "units"),
    [
        (("Time_us", "b0", "b1", "speed [mm/s]"), {"time": "us", "counts": "count", "speed": "mm/s"}),
        (("elapsed_time_s", "b0", "b1", "tcp_speed_mm_s"), {"time": "s", "counts": "count", "speed": "mm/s"}),
        (("millis", "p0 [mPa]", "p1 [mPa]"), {"time": "ms", "counts": "mPa"}),
        (("t [\u00b5s]", "p0 [mmHg]", "p1 [mmHg]"), {"time": "us", "counts": "mmHg"}),
        (("t", "p0 [a.u.]", "p1 [a.u.]"), {"counts": "count"}),
        (("t", "p0 [foo]", "p1 [foo]"), {"counts": "foo"}),
    ],
)
def test_units_are_read_from_the_names(names: tuple[str, ...], units: dict[str, str]) -> None:
    assert roles(names).units == units


@pytest.mark.parametrize(
    ("names", "columns", "complaint"),
    [
        (
            ("t", "a0 [kPa]", "a1 [kPa]", "b0 [mbar]", "b1 [mbar]"),
            "counts.0=a0 [kPa],a1 [kPa],counts.1=b0 [mbar],b1 [mbar]",
            "units differ, a0 [kPa] has kPa and b0 [mbar] has mbar: convert them to one, or state units",
        ),
        (
            ("t", *CELLS, "speed [mm/min]"),
            "speed=speed [mm/min]",
            "unit mm/min of column speed [mm/min] must be m/s",
        ),
        (
            ("t", *CELLS, "vx [mm/s]", "vy [mm/s]", "vz"),
            "velocity=vx [mm/s],vy [mm/s],vz",
            "units differ, vx [mm/s] has mm/s and vz has no unit: convert them",
        ),
    ],
)
def test_columns_of_one_quantity_with_different_units_are_refused(
    names: tuple[str, ...], columns: str, complaint: str
) -> None:
    with pytest.raises(InputError, match=re.escape(complaint)):
        roles(names, columns)
    quantity = columns.partition("=")[0].partition(".")[0]
    unit = "kPa" if quantity == "counts" else "mm/s"
    assert roles(names, f"{columns},units.{quantity}={unit}").units[quantity] == unit


def test_the_angular_velocity_may_have_a_unit_of_its_own() -> None:
    axes = [f"v{axis} [mm/s]" for axis in "xyz"] + [f"w{axis} [rad/s]" for axis in "xyz"]
    assert roles(("t", *CELLS, *axes), f"velocity={','.join(axes)}").units["velocity"] == "mm/s"


@pytest.mark.parametrize(
    ("fingers", "refused"),
    [
        ([0, 1] * 30, True),
        ([*["left"] * 20, *["right"] * 20, *["left"] * 20], False),
        ([*["left"] * 30, *["right"] * 30], False),
        ([0] * 60, False),
        ([*range(60)], False),
        ([*range(15)], False),  # a short recording with a counter
    ],
)
@pytest.mark.parametrize("name", ["sensor_id", "id", "topic", "i2c_addr", "channel", "frame_no"])
def test_rows_of_fingertips_that_alternate_are_refused(
    name: str, fingers: list[object], *, refused: bool
) -> None:
    frame = {"t": [*range(len(fingers))], "p0": fingers, "p1": fingers, name: fingers}
    table = RawTable.of(pl.DataFrame(frame), "pad")
    completed(table, ColumnMap())
    reasons = [reason for _, reason in table.problems.values()]
    assert len(reasons) == (refused and name != "frame_no")
    for reason in reasons:
        assert reason.startswith(f"column {name} alternates between 2")


@pytest.mark.parametrize(
    ("columns", "hint"),
    [
        ({"state": ["slip", "stick"]}, "state"),
        ({"slip_event": ["0", "1"]}, "slip_event"),
        ({"Zustand": ["rutscht", "haftet"]}, "Zustand"),
        ({"state": ["slip", "stick"], "label": ["0", "1"]}, ""),
        ({"surface": ["wood", "steel"], "contact": ["0", "1"]}, ""),
    ],
)
def test_a_column_that_may_have_labels_is_a_hint(columns: dict[str, list[str]], hint: str) -> None:
    frame = {"t": ["0", "0.01"], "p0": ["5", "6"], "p1": ["5", "6"], **columns}
    table = RawTable.of(pl.DataFrame(frame), "pad")
    completed(table, ColumnMap())
    assert table.warnings == ([(None, f"column {hint} may have labels: state label={hint}")] if hint else [])


def test_a_suggested_map_has_neither_labels_nor_some_of_the_cells() -> None:
    names = {f"column{k}": [f"{k}.5", f"{k}.7", f"{k}.6"] for k in range(1, 5)}
    table = RawTable.of(pl.DataFrame({**names, "column5": ["0", "1", "0"]}), "pad")
    completed(table, ColumnMap(rate=100))
    assert table.suggested == ["counts=column1..column4"]
    table.left_out = {"p0": "it occurs twice"}
    completed(table, ColumnMap(rate=100))
    assert table.suggested == ["counts=NAME,NAME"]


def test_case_counts_where_it_carries_meaning() -> None:
    assert [unit_in(each) for each in ("mPa", "MPa", "mN", "g", "G", "kPA", "Pa", "PSI", "MS")] == [
        *("mPa", "MPa", "mN", "g", "G", "kPa", "Pa", "psi", "ms")
    ]
    assert not any(map(unit_in, ("MPA", "MN", "t", "v", "Mv")))
    with pytest.raises(
        InputError, match=r"unit MPA of column p0 \[MPA\] must be mPa or MPa: state units\.counts="
    ):
        roles(("t", "p0 [MPA]", "p1 [MPA]"))


def test_mapped_columns_are_not_recognised_by_name() -> None:
    names = ("t", "time_ns", *CELLS, "label", "slip", "v")
    found = roles(names, "time=time_ns,label=,velocity=s1,s2,s3")
    assert found.columns == {"time": ("time_ns",), "counts": CELLS, "velocity": ("s1", "s2", "s3")}
    assert found.units == {"time": "ns", "counts": "count", "velocity": "m/s"}
    assert "speed" not in roles(("t", "v", "w"), "counts=v,w").columns
