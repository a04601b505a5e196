"""The command line as a user meets it: its help, and what a mistake gives."""

import pytest
import typer
from typer.testing import CliRunner

from flows.cli import experiments, main
from tests.command import error, slipflow


def names(app: typer.Typer) -> list[str]:
    """What its commands are called."""
    given = [each.name or getattr(each.callback, "__name__", "") for each in app.registered_commands]
    return [*given, *(str(group.name) for group in app.registered_groups)]


def test_help_names_every_command() -> None:
    assert len(names(main.app)) > 15
    shown = {line.split()[0] for line in slipflow("--help").stdout.splitlines() if line.startswith("  ")}
    assert set(names(main.app)) <= shown


@pytest.mark.parametrize(
    "words",
    [*([name] for name in names(main.app)), *(["experiment", n] for n in names(experiments.app))],
    ids=" ".join,
)
def test_each_command_has_a_help_of_its_own(words: list[str]) -> None:
    shown = CliRunner().invoke(main.app, [*words, "--help"], prog_name="slipflow")
    assert shown.exit_code == 0
    assert shown.output.split()[: 2 + len(words)] == ["Usage:", "slipflow", *words]
    assert words == ["experiment"] or "Examples:" in shown.output


def test_debug_shows_the_traceback() -> None:
    done = slipflow("--debug", "run", "nowhere.py")
    assert done.returncode == 1
    assert "Traceback" in done.stderr


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
        ("experiment lit", "no such command 'lit'. Did you mean 'lift'? See slipflow experiment --help"),
        ("demo --seed x", "invalid value for '--seed': must be a valid integer. See slipflow demo --help"),
        ("simulate", "give OUT, the dataset's folder, or --report DIR"),
    ],
)
def test_wrong_usage_is_one_line_that_says_how_to_write_it(words: str, line: str) -> None:
    assert error(*words.split()).startswith(line)


def test_without_a_command_its_help_is_shown() -> None:
    for words in ([], ["experiment"]):
        done = slipflow(*words)
        assert (done.returncode, done.stderr.splitlines()[0].split()[0]) == (2, "Usage:")
        assert "error: " not in done.stderr
