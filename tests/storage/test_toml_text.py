"""TOML and JSON of strangers: an error with its place, within seconds, whatever they contain."""

from time import monotonic

import pytest
from hypothesis import given
from hypothesis import strategies as st

from connectors.files.column_map import ColumnMap
from flows.lab.collection.plan_file import load_plan
from operators.errors import InputError, SlipflowError
from storage.toml_text import parse_toml
from tests.waiting import PATIENCE

sizes = st.integers(500, 20_000)
prefixes = st.sampled_from(["", "-", "0x", "0b", "0o"])
numbers = st.builds(lambda prefix, size: prefix + "1" * size, prefixes, sizes)
values = st.one_of(
    numbers,
    sizes.map(lambda size: "[" * size + "]" * size),
    sizes.map(lambda size: "{a=" * size + "1" + "}" * size),
    sizes.map(lambda size: "[" * size),
    sizes.map(lambda size: "1." + "3" * size),
    sizes.map(lambda size: "1e" + "9" * size),
)
keys = sizes.map(lambda size: ".".join("a" * size))
lines = st.one_of(
    st.builds("time = {}".format, values),
    st.builds("rate = {}".format, values),
    st.builds("{} = 1".format, keys),
    st.builds("[{}]".format, keys),
    st.builds("[path]\nrest = {}".format, values),
)


@given(lines)
def test_a_file_without_limits_is_an_error_with_its_line(line: str) -> None:
    began = monotonic()
    with pytest.raises(InputError, match=r"^mine.toml, line [23]: (nests|has a number of) more than \d+ "):
        parse_toml(f"name = 'mine'\n{line}\n", "mine.toml")
    assert monotonic() - began < PATIENCE


@given(line=lines)
def test_maps_and_plans_without_limits_are_errors(
    line: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("toml") / "mine.toml"
    path.write_text(line)
    for load in (ColumnMap.load, load_plan):
        with pytest.raises(SlipflowError, match=r"mine\.toml, line \d") as raised:
            load(str(path))
        assert len(str(raised.value)) < 1000


@pytest.mark.parametrize("value", ["9223372036854775808", "-" + "9" * 300, "0x" + "f" * 300])
def test_a_number_of_more_than_64_bits_is_an_error_with_its_key(value: str) -> None:
    with pytest.raises(InputError, match=r"^a\.toml: path\.x\.y is a number of more than 64 bits"):
        parse_toml(f"[path]\nx = [{{y = {value}}}]", "a.toml")


def test_other_mistakes_have_their_line_and_usual_files_are_read() -> None:
    with pytest.raises(InputError, match=r"^a\.toml: is not valid TOML: .*line 2"):
        parse_toml("a = 1\nb =\n", "a.toml")
    text = 'a = ["[[[[", 1.5, 2.5]\n# ' + "[" * 99 + "\n[b.c]\nd = {e = -9223372036854775808}\n"
    assert parse_toml(text, "a.toml") == {"a": ["[[[[", 1.5, 2.5], "b": {"c": {"d": {"e": -(2**63)}}}}
