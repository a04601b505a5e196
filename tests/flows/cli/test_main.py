"""The command line in processes of its own: help, version and usage errors."""

from importlib.metadata import version

import pytest
import typer
from typer.testing import CliRunner

from flows.cli import experiments, main
from tests.command import error, slipflow


def names(app: typer.Typer) -> list[str]:
    """Return the names of its commands."""
    commands = [str(each.name) for each in app.registered_commands]
    return commands + [str(each.name) for each in app.registered_groups]


def test_help_lists_every_command_in_panels_with_the_most_used_first() -> None:
    assert len(names(main.app)) > 15
    text = slipflow("--help").stdout
    shown = [line.split()[0] for line in text.splitlines() if line.startswith("  ")]
    assert set(names(main.app)) <= set(shown)
    panels = ["Record and run:", "View:", "Train and evaluate:", "Robots:", "Data:"]
    assert [line for line in text.splitlines() if line in panels] == panels
    assert shown[shown.index("run") :][:4] == ["run", "demo", "check", "graph"]


def test_version_prints_the_installed_version() -> None:
    done = slipflow("--version")
    assert (done.returncode, done.stdout) == (0, f"slipflow {version('slipflow')}\n")


@pytest.mark.parametrize(
    "words",
    [*([name] for name in names(main.app)), *(["experiment", n] for n in names(experiments.app))],
    ids=" ".join,
)
def test_each_command_has_help_with_examples(words: list[str]) -> None:
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
        ("simulate", "missing argument 'OUT'. See slipflow simulate --help"),
    ],
)
def test_wrong_usage_is_one_line_with_the_fix(words: str, line: str) -> None:
    assert error(*words.split()).startswith(line)


def test_without_a_command_its_help_is_shown() -> None:
    for words in ([], ["experiment"]):
        done = slipflow(*words)
        assert (done.returncode, done.stderr.splitlines()[0].split()[0]) == (2, "Usage:")
        assert "error: " not in done.stderr
