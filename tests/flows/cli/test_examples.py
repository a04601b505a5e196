import shlex
from typing import Any

import pytest
import typer.core
import typer.main

from flows.cli.examples import EXAMPLES
from flows.cli.main import app


def commands(group: typer.core.TyperGroup) -> dict[str, Any]:
    """All that can be run, by its own name."""
    found = dict[str, Any]()
    for name, command in group.commands.items():
        found |= commands(command) if isinstance(command, typer.core.TyperGroup) else {name: command}
    return found


ROOT = typer.main.get_command(app)
assert isinstance(ROOT, typer.core.TyperGroup)
ALL = commands(ROOT)


def test_every_command_has_examples_and_every_example_a_command() -> None:
    assert set(EXAMPLES) == set(ALL)


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_command_takes_its_examples_and_its_help_shows_them_whole(name: str) -> None:
    command = ALL[name]
    for line in EXAMPLES[name]:
        program, *words = shlex.split(line.partition(" > ")[0])
        assert program == "slipflow"
        words = words[words.index(name) + 1 :]
        context = command.make_context(name, words)  # which raises if it takes them not
        assert f"    {line}\n" in f"{context.get_help()}\n"


@pytest.mark.parametrize("name", ALL)
def test_the_list_of_commands_cuts_no_sentence_off(name: str) -> None:
    if name != "show":
        assert not ALL[name].get_short_help_str(62).endswith("...")
