"""Map of the columns of a recording."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.files.column_map import ColumnMap
from operators.errors import ParameterError

TEXT = (
    "time=my t, counts=a,b,c3..c1,d,label=,speed = v,units.time=ms,units.speed=mm/s,labels.slip=1,2,"
    "layout=5,4,3/0,1,2,range=1023:0,rate=100,zeroed=true,resolution=0.5"
)


def test_commas_or_line_breaks_separate_the_items_of_a_text() -> None:
    found = ColumnMap.parse(TEXT)
    assert found == ColumnMap.parse(TEXT.replace(",speed", "\nspeed").replace(",layout", ",\nlayout") + "\n")
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


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("t.map", "must be written as time=t,counts=p0..p5,units.time=ms; for a file: @t.map"),
        ("force=f", "key is 'force', must be one of time, date, counts"),
        ("counts=p0..p127,p128", "must be 1 to 128 column names"),
        ("velocity=a,b", "velocity is 'a,b', must be 3 or 6 column names"),
        ("counts=p0..q5", "range of columns is 'p0..q5', must be of one name"),
        ("counts=p0..p99999999999", "must be of 128 columns at most"),
        ("speed=v,velocity=x,y,z", "speed is 'v', must be omitted, since velocity is given"),
        ("units.label=s", "quantity with a unit is 'label', must be one of time, counts, velocity, speed"),
        ("units.time=week", "unit of time is 'week', must be one of s, ms, us, ns"),
        ("units.counts=kpa", "unit of counts is 'kpa', must be one of count, mPa, Pa, hPa, kPa"),
        ("labels.sliding=1", "label is 'sliding', must be one of slip, static, unknown"),
        ("layout=wide", "layout is 'wide', must be ROWSxCOLUMNS such as 8x2"),
        ("layout=0x4", "128 cells at most"),
        ("range=4000", "range is '4000', must be LOW:HIGH"),
        ("range=0:nan:1", "range is '0:nan:1', must be LOW:HIGH"),
        ("rate=fast", "rate is 'fast', must be a number"),
        ("rate=0", "rate is 0.0, must be above 0"),
        ("counts.99999=a", "finger is 99999, must be from 0 to 32767"),
        ("counts=a,counts.0=b", "counts is 'a', must be omitted beside counts.0"),
        ("zeroed=yes", "zeroed is 'yes', must be true or false"),
        ({"counts.left": ("a",)}, "quantity is 'counts.left', must be counts, or counts.1 of fingertip 1"),
        ({"time.x": ("a",)}, "quantity is 'time.x', must be time, or counts.1 of fingertip 1"),
    ],
)
def test_an_invalid_map_is_refused(text: str | dict[str, tuple[str, ...]], complaint: str) -> None:
    with pytest.raises(ParameterError) as caught:
        ColumnMap.parse(text) if isinstance(text, str) else ColumnMap(text)
    assert complaint in str(caught.value)


@given(st.text(alphabet="tc=,.0123456789p ", max_size=30))
def test_any_text_is_a_map_or_refused(text: str) -> None:
    with suppress(ParameterError):
        found = ColumnMap.parse(text)
        assert all(len(each) in (0, 1, 3, 6) or name == "counts" for name, each in found.columns.items())
