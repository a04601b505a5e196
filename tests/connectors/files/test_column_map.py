"""Map of the columns of a recording."""

from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.files.column_map import ColumnMap, layout_text
from connectors.files.roles import Header, completed
from operators.errors import InputError, ParameterError

CELLS = ("s1", "s2", "s3", "s4", "s5", "s6")


TEXT = (
    "time=my t, counts=a,b,c3..c1,d,label=,speed = v,units.time=ms,units.speed=mm/s,labels.slip=1,2,"
    "layout=5,4,3/0,1,2,range=1023:0,rate=100,zeroed=true,finger=2,resolution=0.5"
)
FILE = """
time = "my t"
counts = ["a", "b", "c3..c1", "d"]
label = ""
speed = "v"
layout = "5,4,3/0,1,2"
range = "1023:0"
rate = 100
zeroed = true
finger = 2
resolution = 0.5
units = { time = "ms", speed = "mm/s" }
labels = { slip = [1, "2"] }
"""


def test_a_text_and_a_file_have_the_same_keys(tmp_path: Path) -> None:
    (tmp_path / "pad.toml").write_text(FILE)
    found = ColumnMap.load(str(tmp_path / "pad.toml"))
    assert found == ColumnMap.load(TEXT) == ColumnMap.parse(TEXT)
    assert found == ColumnMap(
        {"time": ("my t",), "counts": ("a", "b", "c3", "c2", "c1", "d"), "label": (), "speed": ("v",)},
        {"time": "ms", "speed": "mm/s"},
        {"slip": ("1", "2")},
        resolution=0.5,
        layout=((5, 4, 3), (0, 1, 2)),
        range=(1023, 0),
        rate=100,
        zeroed=True,
        finger=2,
    )
    assert (found.scale("time"), found.scale("speed")) == (1e6, 0.001)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"time = ", "pad.toml: is not valid TOML: Invalid value"),
        (b"\xff", "pad.toml: is not valid TOML: 'utf-8' codec"),
        (b"a = 1" + b"0" * 5000, "pad.toml: is not valid TOML: Exceeds the limit"),
        (b"tim = 't'", "pad.toml: key is 'tim', must be one of time, counts"),
        (b"rate = 'fast'", "pad.toml: rate is 'fast', must be a number"),
        (b"rate = [1, 2]", "pad.toml: rate is '1,2', must be a number"),
    ],
)
def test_an_invalid_file_is_named(tmp_path: Path, content: bytes, complaint: str) -> None:
    path = tmp_path / "pad.toml"
    path.write_bytes(content)
    with pytest.raises((InputError, ParameterError)) as caught:
        ColumnMap.load(str(path))
    assert str(caught.value).startswith(f"{tmp_path}/{complaint}")
    with pytest.raises(InputError, match=r"absent.toml: cannot be read: No such file"):
        ColumnMap.load("absent.toml")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("t", "--map is 't', must be written as time=t"),
        ("force=f", "key is 'force', must be one of time, counts"),
        ("counts=p0..p127,p128", "must be 1 to 128 column names"),
        ("velocity=a,b", "velocity is 'a,b', must be 3 or 6 column names"),
        ("counts=p0..q5", "range of columns is 'p0..q5', must be of one name"),
        ("counts=p0..p99999999999", "must be of 128 columns at most"),
        ("speed=v,velocity=x,y,z", "speed is 'v', must be omitted, since velocity is given"),
        ("units.label=s", "quantity with a unit is 'label', must be one of time, counts, velocity, speed"),
        ("units.time=min", "unit of time is 'min', must be one of s, ms, us, ns"),
        ("units.speed=", "unit of speed is '', must be one of m/s"),
        ("units.counts=kpa", "unit of counts is 'kpa', must be one of count, Pa, hPa, mbar, kPa"),
        ("labels.sliding=1", "label is 'sliding', must be one of slip, static, unknown"),
        ("layout=wide", "layout is 'wide', must be ROWSxCOLUMNS such as 8x2"),
        ("layout=0x4", "128 cells at most"),
        ("layout=64x64", "128 cells at most"),
        ("range=4000", "range is '4000', must be LOW:HIGH"),
        ("range=0:nan:1", "range is '0:nan:1', must be LOW:HIGH"),
        ("range=0:nan", "range is '0:nan', must be LOW:HIGH"),
        ("rate=0", "rate is 0.0, must be above 0"),
        ("finger=-1", "finger is -1, must be from 0 to 32767"),
        ("finger=1.5", "finger is '1.5', must be a whole number"),
        ("zeroed=yes", "zeroed is 'yes', must be true or false"),
    ],
)
def test_an_invalid_map_is_refused(text: str, complaint: str) -> None:
    with pytest.raises(ParameterError) as caught:
        ColumnMap.parse(text)
    assert complaint in str(caught.value)


def test_a_layout_that_is_printed_can_be_parsed() -> None:
    layout = ((5, 4, 3), (0, -1, 1), (2,))
    assert ColumnMap.parse(f"layout={layout_text(layout)}").layout == layout


@given(st.text(alphabet="tc=,.0123456789p ", max_size=30))
def test_any_text_is_a_map_or_refused(text: str) -> None:
    with suppress(ParameterError):
        found = ColumnMap.parse(text)
        assert all(
            len(columns) in (0, 1, 3, 6) or name == "counts" for name, columns in found.columns.items()
        )


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
    found = completed(ColumnMap(), Header(names, "line 1")).columns
    assert held.items() <= found.items()
    assert not {"velocity", "speed"} <= set(found)


@pytest.mark.parametrize("cells", [1, 2, 7, 16, 64])
def test_numbered_columns_are_the_cells_of_a_fingertip(cells: int) -> None:
    for first in (0, 1):
        names = tuple(f"taxel{number}" for number in range(first, first + cells))
        assert completed(ColumnMap(), Header(("t", *names[::-1]), "line 1")).columns["counts"] == names


def test_one_numbered_column_is_a_cell_only_if_no_other_columns_are() -> None:
    assert completed(ColumnMap(), Header(("t", "b1", *CELLS))).columns["counts"] == CELLS
    with pytest.raises(InputError, match="several candidates for counts: 'b1' or 's1'"):
        completed(ColumnMap(), Header(("t", "b1", "s1")))


@pytest.mark.parametrize("names", [("s2",), ("s1", "s3"), ("s2", "s3"), ("left", "right")])
def test_other_columns_are_no_fingertip(names: tuple[str, ...]) -> None:
    with pytest.raises(
        InputError, match=r"none recognised as counts; map it .*ColumnMap.* or counts=left,right,"
    ):
        completed(ColumnMap(), Header(("t", *names), "line 1"))


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
        completed(ColumnMap(), Header(names, "line 1"))
    assert complaint in str(caught.value)


def test_a_column_cannot_be_two_cells() -> None:
    with pytest.raises(InputError, match="column e1 cannot be two cells"):
        completed(ColumnMap.parse("counts=e1,e2,e1"), Header(("t", "e1", "e2")))


@pytest.mark.parametrize(
    ("names", "units"),
    [
        (("t", *(f"p{cell}_kPa" for cell in range(4))), {"time": "s", "counts": "kPa"}),
        (("time [ms]", "cell 1 (N)", "cell 2 (N)"), {"time": "ms", "counts": "N"}),
        (("Time_us", "b0", "b1", "speed [mm/s]"), {"time": "us", "counts": "count", "speed": "mm/s"}),
    ],
)
def test_units_are_read_from_the_names(names: tuple[str, ...], units: dict[str, str]) -> None:
    assert completed(ColumnMap(), Header(names)).units == units


def test_mapped_columns_are_not_recognised_by_name() -> None:
    names = ("t", "time_ns", *CELLS, "label", "slip", "v")
    said = ColumnMap.parse("time=time_ns,label=,velocity=s1,s2,s3")
    found = completed(said, Header(names, "line 1"))
    assert found.columns == {"time": ("time_ns",), "counts": CELLS, "velocity": ("s1", "s2", "s3")}
    assert found.units == {"time": "ns", "counts": "count", "velocity": "m/s"}
