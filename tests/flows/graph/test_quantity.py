from fractions import Fraction

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from flows.graph.quantity import KINDS, format_quantity, parse_quantity
from operators.errors import ParameterError


@given(
    st.sampled_from([(unit, name) for unit, kind in KINDS.items() for name in kind.units]),
    st.decimals(0, 10**6, places=3).map(lambda number: f"{number:f}".rstrip("0")),
    st.sampled_from(["", " ", "  "]),
)
def test_a_quantity_is_exact_in_its_base_unit(units: tuple[str, str], number: str, gap: str) -> None:
    unit, name = units
    exact = Fraction(number) * Fraction(KINDS[unit].units[name])
    found = parse_quantity("x", "y", f" {number}{gap}{name} ", unit)
    assert found == (round(exact) if unit == "ns" else float(exact))
    assert isinstance(found, int if unit == "ns" else float)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("70", "ns"),
        ("70mm", "ns"),
        ("1e3s", "ns"),
        ("-5s", "ns"),
        ("1.2.3s", "ns"),
        ("", "ns"),
        ("2", "m"),
        ("2m", "m/s"),
        ("nanN", "N"),
        ("٣s", "ns"),
        ("9" * 10_000 + "s", "ns"),
        ("1." + "0" * 37 + "mm", "m"),  # its first 40 characters are 1 m
    ],
)
def test_an_invalid_quantity_is_reported_with_examples(text: str, unit: str) -> None:
    with pytest.raises(ParameterError, match=r"flow: delay is .* with its unit: ") as raised:
        parse_quantity("flow", "delay", text, unit)
    assert raised.value.must_be == f"{KINDS[unit].name} with its unit: {KINDS[unit].examples}"


@given(st.integers(-(2**62), 2**62))
@example(49_999_999_999_999_948)
def test_a_formatted_time_parses_to_the_same_value(time: int) -> None:
    text = format_quantity(time, "ns")
    assert parse_quantity("x", "y", text, "ns", signed=True) == pytest.approx(time, rel=1e-14)


@pytest.mark.parametrize("unit", KINDS)
def test_the_examples_are_such_quantities(unit: str) -> None:
    for text in KINDS[unit].examples.replace(" or ", ", ").split(", "):
        assert parse_quantity("x", "y", text, unit) > 0


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (90 * 10**9, "ns", "90s"),
        (1800 * 10**9, "ns", "30min"),
        (1, "ns", "1ns"),
        (0, "ns", "0ns"),
        (0.0015, "m", "1.5mm"),
        (1e-05, "m", "1e-05m"),
        (10.0, "N", "10N"),
    ],
)
def test_a_quantity_has_the_shortest_text(value: float, unit: str, text: str) -> None:
    assert format_quantity(value, unit) == text
