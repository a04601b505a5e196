import shlex
from typing import Any

import pytest
import typer
import typer.core
import typer.main

from flows.cli.main import app, usage_error


def commands(group: typer.core.TyperGroup) -> dict[str, Any]:
    """Return all commands by name, those of groups included."""
    found = dict[str, Any]()
    for name, command in group.commands.items():
        found |= commands(command) if isinstance(command, typer.core.TyperGroup) else {name: command}
    return found


ROOT = typer.main.get_command(app)
assert isinstance(ROOT, typer.core.TyperGroup)
ALL = commands(ROOT)


def usage(*words: str) -> str:
    with pytest.raises(typer.TyperException) as raised:
        app(list(words), standalone_mode=False, prog_name="slipflow")
    return usage_error(raised.value)


@pytest.mark.parametrize("name", ALL)
def test_the_help_of_a_command_fits_on_one_screen_and_its_examples_are_accepted(name: str) -> None:
    shown = ALL[name].make_context(name, [], resilient_parsing=True, terminal_width=100).get_help()
    assert len(shown.splitlines()) <= 45
    examples = shown.partition("Examples:\n")[2].strip()
    assert examples
    for line in examples.splitlines():
        program, *words = shlex.split(line.partition(" > ")[0])
        assert program == "slipflow"
        ALL[name].make_context(name, words[words.index(name) + 1 :])  # raises an error if it does not


def test_the_message_of_a_command_is_one_line() -> None:
    assert usage_error(typer.BadParameter("--set a\nb: write\n it")) == "error: --set a b: write it"


def test_no_command_prints_the_help() -> None:
    assert usage().startswith("Usage: slipflow [OPTIONS] COMMAND")
