from pathlib import Path
from typing import Literal

import pytest

from flows.graph.parameter import Parameter
from flows.graph.quantity import Duration, Force, Speed
from operators.batch import ms
from operators.errors import ParameterError


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (Duration, "70ms", 70 * ms),
        (Duration, "-70ms", -70 * ms),
        (Duration | None, "none", None),
        (Duration | None, "1s", 1000 * ms),
        (Speed, "0.003", 0.003),
        (Speed, "3mm/s", 0.003),
        (Force, "2N", 2.0),
        (Literal["a", "b"], "b", "b"),
        (Literal["a", 3] | None, "3", 3),
        (bool, "Yes", True),
        (int | None, "", None),
        (int | None, "4", 4),
        (Path, "a/b", Path("a/b")),
        (str, "none", "none"),
    ],
)
def test_text_becomes_the_type_that_is_declared(kind: object, text: str, value: object) -> None:
    found = Parameter("x", kind, None).value("flow", text)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("kind", "text", "takes"),
    [
        (int, "two", "a whole number"),
        (float, "two", "a number"),
        (bool, "maybe", "yes or no"),
        (int | None, "two", "a whole number or none"),
        (Duration, "70", "a time with its unit: 500ms, 30s, 1h or 30d"),
        (Speed, "fast", "a speed with its unit: 3mm/s or 0.003m/s"),
        (Literal["a", "b"], "c", "a or b"),
        (Force, "1e400", "a force with its unit: 2N or 0.5N"),
    ],
)
def test_text_of_another_type_is_reported_with_the_accepted_text(kind: object, text: str, takes: str) -> None:
    with pytest.raises(ParameterError) as raised:
        Parameter("x", kind, None).value("flow", text)
    assert str(raised.value) == f"flow: x is {text!r}, must be {takes}"


@pytest.mark.parametrize(
    ("parameter", "text"),
    [
        (Parameter("delay", Duration, 70 * ms), "delay=70ms"),
        (Parameter("speed", Speed, 0.003), "speed=3mm/s"),
        (Parameter("force", Force, 0.0), "force=0N"),
        (Parameter("delay", Duration | None, None), "delay=None"),
        (Parameter("seed", int, 3), "seed=3"),
    ],
)
def test_the_listed_setting_parses_to_the_default(parameter: Parameter, text: str) -> None:
    listed = str(parameter).split("  (")[0]
    assert listed == text
    assert parameter.value("flow", listed.partition("=")[2]) == parameter.default


def test_a_default_without_end_is_listed_too() -> None:
    assert str(Parameter("limit", Speed, float("inf"))).startswith("limit=inf  (a speed with its unit: ")


@pytest.mark.parametrize("kind", [str, Path])
def test_empty_text_as_of_a_variable_that_is_not_set_is_refused(kind: object) -> None:
    with pytest.raises(ParameterError, match="record: out is '', must be "):
        Parameter("out", kind, "recordings").value("record", "")
    assert Parameter("note", str, "").value("record", "") == ""
