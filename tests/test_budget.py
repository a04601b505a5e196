"""Budget of the project: lines, files, commands, options and words may only fall."""

import re
from pathlib import Path
from typing import Any

import pytest
import typer.main

from flows.cli.main import app

ROOT = Path(__file__).parents[1]
PRODUCT = ("operators", "connectors", "storage", "flows")
BUDGET = {  # lower a number when the project has become smaller; never raise one
    "operators": 4_916,
    "connectors": 10_413,
    "storage": 3_804,
    "flows": 12_059,
    "product": 31_192,
    "product files": 212,
    "tests": 29_170,
    "commands": 16,
    "options": 64,
    "words": 34_982,
}


def lines(folder: str) -> int:
    return sum(len(path.read_text().splitlines()) for path in (ROOT / folder).rglob("*.py"))


def command_line() -> tuple[int, int]:
    """Return the number of commands and of their options, without --help."""
    root: Any = typer.main.get_command(app)
    options = {
        (command.name, option.name)
        for command in root.commands.values()
        for option in command.params
        if option.param_type_name == "option" and option.name != "help"
    }
    return len(root.commands), len(options)


def words() -> int:
    return sum(len(re.findall(r"\S+", path.read_text())) for path in (ROOT / "docs").rglob("*.md"))


def sizes() -> dict[str, int]:
    commands, options = command_line()
    folders = {folder: lines(folder) for folder in PRODUCT}
    return {
        **folders,
        "product": sum(folders.values()),
        "product files": sum(1 for folder in PRODUCT for _ in (ROOT / folder).rglob("*.py")),
        "tests": lines("tests"),
        "commands": commands,
        "options": options,
        "words": words(),
    }


@pytest.mark.parametrize("name", BUDGET)
def test_the_project_stays_within_its_budget(name: str) -> None:
    assert sizes()[name] <= BUDGET[name]


if __name__ == "__main__":
    for key, size in sizes().items():
        print(f"{key:14} {size:7,} of {BUDGET[key]:7,}")  # noqa: T201
