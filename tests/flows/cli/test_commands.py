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
def test_each_command_accepts_the_examples_of_its_help(name: str) -> None:
    examples = ALL[name].make_context(name, [], resilient_parsing=True).get_help().partition("Examples:\n")[2]
    assert examples.strip()
    for line in examples.strip().splitlines():
        program, *words = shlex.split(line.partition(" > ")[0])
        assert program == "slipflow"
        ALL[name].make_context(name, words[words.index(name) + 1 :])  # raises an error if it does not


@pytest.mark.parametrize("name", ALL)
def test_the_help_of_a_command_fits_on_one_screen(name: str) -> None:
    shown = ALL[name].make_context(name, [], resilient_parsing=True, terminal_width=100).get_help()
    assert len(shown.splitlines()) <= 45


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("run live --fr 5s", "no such option: --fr. Did you mean --for? See slipflow run --help"),
        ("run", "missing argument 'FILE[:FLOW]'. See slipflow run --help"),
        (
            "run live --log xml",
            "invalid value for '--log': 'xml' is not one of 'text', 'json'. See slipflow run",
        ),
        ("rum live", "no such command 'rum'. Did you mean 'run'? See slipflow --help"),
        (
            "simulate out --seed x",
            "invalid value for '--seed': must be a valid integer. See slipflow simulate",
        ),
        ("simulate", "missing argument 'OUT'. See slipflow simulate --help"),
        ("run live --pace 0", "invalid value for '--pace': must be greater than or equal to 0.01. See slip"),
    ],
)
def test_wrong_usage_is_one_line_with_the_fix(words: str, line: str) -> None:
    assert usage(*words.split()).startswith(f"error: {line}")


def test_the_message_of_a_command_is_one_line() -> None:
    assert usage_error(typer.BadParameter("--set a\nb: write\n it")) == "error: --set a b: write it"


def test_no_command_prints_the_help() -> None:
    assert usage().startswith("Usage: slipflow [OPTIONS] COMMAND")
