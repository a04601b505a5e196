"""TOML files of users: an error with its place, whatever they contain."""

import pytest

from operators.errors import InputError
from storage.toml_text import parse_toml


@pytest.mark.parametrize(
    "line",
    [
        "rate = " + "[" * 5_000 + "]" * 5_000,
        "rate = " + "{a=" * 5_000 + "1" + "}" * 5_000,
        "rate = " + "1" * 5_000,
        ".".join("a" * 2_000) + " = 1",
    ],
)
def test_a_line_that_cannot_be_parsed_is_an_error(line: str) -> None:
    with pytest.raises(InputError, match=r"^mine\.toml: is not valid TOML: "):
        parse_toml(line, "mine.toml")


@pytest.mark.parametrize("value", ["9223372036854775808", "-" + "9" * 300, "0x" + "f" * 300])
def test_a_number_of_more_than_64_bits_is_an_error_with_its_key(value: str) -> None:
    with pytest.raises(InputError, match=r"^a\.toml: path\.x\.y is a number of more than 64 bits"):
        parse_toml(f"[path]\nx = [{{y = {value}}}]", "a.toml")


def test_other_mistakes_have_their_line_and_usual_files_are_read() -> None:
    with pytest.raises(InputError, match=r"^a\.toml: is not valid TOML: .*line 2"):
        parse_toml("a = 1\nb =\n", "a.toml")
    text = 'a = ["[[[[", 1.5, 2.5]\n# ' + "[" * 99 + "\n[b.c]\nd = {e = -9223372036854775808}\n"
    assert parse_toml(text, "a.toml") == {"a": ["[[[[", 1.5, 2.5], "b": {"c": {"d": {"e": -(2**63)}}}}
