import shlex
from typing import Any

import pytest
import typer
import typer.main

from flows.cli.main import app, usage_error

ROOT: Any = typer.main.get_command(app)


@pytest.mark.parametrize("name", ROOT.commands)
def test_the_help_of_a_command_fits_on_one_screen_and_its_examples_are_accepted(name: str) -> None:
    command = ROOT.commands[name]
    shown = command.make_context(name, [], resilient_parsing=True, terminal_width=100).get_help()
    assert len(shown.splitlines()) <= 45
    examples = shown.partition("Examples:\n")[2].strip()
    assert examples
    for line in examples.splitlines():
        program, *words = shlex.split(line.partition(" > ")[0])
        assert program == "slipflow"
        command.make_context(name, words[words.index(name) + 1 :])  # raises an error if it does not


def test_the_message_of_a_command_is_one_line() -> None:
    assert usage_error(typer.BadParameter("--set a\nb: write\n it")) == "error: --set a b: write it"


def test_no_command_prints_the_help() -> None:
    with pytest.raises(typer.TyperException) as raised:
        app([], standalone_mode=False, prog_name="slipflow")
    assert usage_error(raised.value).startswith("Usage: slipflow [OPTIONS] COMMAND")
