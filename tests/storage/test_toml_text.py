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
    ],
)
def test_a_line_that_cannot_be_parsed_is_an_error(line: str) -> None:
    with pytest.raises(InputError, match=r"^mine\.toml: is not valid TOML: "):
        parse_toml(line, "mine.toml")


def test_other_mistakes_have_their_line_and_usual_files_are_read() -> None:
    with pytest.raises(InputError, match=r"^a\.toml: is not valid TOML: .*line 2"):
        parse_toml("a = 1\nb =\n", "a.toml")
    text = 'a = ["[[[[", 1.5, 2.5]\n# ' + "[" * 99 + "\n[b.c]\nd = {e = -9223372036854775808}\n"
    assert parse_toml(text, "a.toml") == {"a": ["[[[[", 1.5, 2.5], "b": {"c": {"d": {"e": -(2**63)}}}}
