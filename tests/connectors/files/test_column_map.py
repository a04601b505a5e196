"""Map of the columns of a recording."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.files.column_map import ColumnMap, layout_text
from operators.errors import InputError, ParameterError

TEXT = (
    "time=my t, counts=a,b,c3..c1,d,label=,speed = v,units.time=ms,units.speed=mm/s,labels.slip=1,2,"
    "layout=5,4,3/0,1,2,range=1023:0,rate=100,zeroed=true,resolution=0.5"
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
    )
    found = replace(found, labels={"slip": ("a,b",)})
    (tmp_path / "pad.toml").write_text(found.toml())
    assert ColumnMap.load(str(tmp_path / "pad.toml")) == found


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"time = ", "pad.toml: is not valid TOML: Invalid value"),
        (b"\xff", "pad.toml: is not text in UTF-8"),
        (b"a = 1" + b"0" * 5000, "pad.toml: is not valid TOML: Exceeds the limit"),
        (b"tim = 't'", "pad.toml: key is 'tim', must be one of time, date, counts"),
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
        ("force=f", "key is 'force', must be one of time, date, counts"),
        ("counts=p0..p127,p128", "must be 1 to 128 column names"),
        ("velocity=a,b", "velocity is 'a,b', must be 3 or 6 column names"),
        ("counts=p0..q5", "range of columns is 'p0..q5', must be of one name"),
        ("counts=p0..p99999999999", "must be of 128 columns at most"),
        ("speed=v,velocity=x,y,z", "speed is 'v', must be omitted, since velocity is given"),
        ("units.label=s", "quantity with a unit is 'label', must be one of time, counts, velocity, speed"),
        ("units.time=week", "unit of time is 'week', must be one of s, ms, us, ns"),
        ("units.speed=", "unit of speed is '', must be one of m/s"),
        ("units.counts=kpa", "unit of counts is 'kpa', must be one of count, mPa, Pa, hPa, kPa"),
        ("labels.sliding=1", "label is 'sliding', must be one of slip, static, unknown"),
        ("layout=wide", "layout is 'wide', must be ROWSxCOLUMNS such as 8x2"),
        ("layout=0x4", "128 cells at most"),
        ("layout=64x64", "128 cells at most"),
        ("range=4000", "range is '4000', must be LOW:HIGH"),
        ("range=0:nan:1", "range is '0:nan:1', must be LOW:HIGH"),
        ("range=0:nan", "range is '0:nan', must be LOW:HIGH"),
        ("rate=0", "rate is 0.0, must be above 0"),
        ("counts.99999=a", "finger is 99999, must be from 0 to 32767"),
        ("counts=a,counts.0=b", "counts is 'a', must be omitted beside counts.0"),
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
