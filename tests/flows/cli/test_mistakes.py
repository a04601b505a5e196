import pytest
import typer

from flows.cli.main import app
from flows.cli.mistakes import mistake


def told(*words: str) -> str:
    with pytest.raises(typer.TyperException) as raised:
        app(list(words), standalone_mode=False, prog_name="slipflow")
    return mistake(raised.value)


def test_what_is_found_before_a_command_begins_says_where_to_look_it_up() -> None:
    assert told("verify") == "error: missing argument 'DATASET|SESSION'. See slipflow verify --help"
    assert told("verify", "a", "--jsn") == (
        "error: no such option: --jsn. Did you mean --json? See slipflow verify --help"
    )


def test_a_number_out_of_range_is_told_without_the_validators_words() -> None:
    line = told("run", "live", "--pace", "0")
    assert line == (
        "error: invalid value for '--pace': must be greater than or equal to 0.01. See slipflow run --help"
    )


def test_what_a_command_says_stands_as_it_is_on_one_line() -> None:
    assert mistake(typer.BadParameter("--set a\nb: write\n it")) == "error: --set a b: write it"


def test_no_command_at_all_gives_the_help() -> None:
    assert told().startswith("Usage: slipflow [OPTIONS] COMMAND")
