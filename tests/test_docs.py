"""The documentation pages: their blocks run, their commands and links exist."""

import json
import os
import re
import sys
from pathlib import Path
from typing import Any

import pytest
import typer.main

from flows.cli.main import app
from tests.command import captured, succeed
from tests.pages import PAGES, ROOT, blocks, commands, mentioned
from tests.reference_pages import FOLDER
from tests.reference_pages import PAGES as GENERATED

RUN = [
    "tutorial/own-detector.md",
    "how-to/any-fingertip.md",
    "how-to/public-recordings.md",
    "how-to/extend.md",
    "how-to/import.md",
    "how-to/lerobot.md",
    "reference/dataset.md",
    "reference/mqtt.md",
]
EXACT = ["how-to/lerobot.md"]  # pages whose numbers are the same in each run
SHOWN = re.compile(r"[\d.,:]+|\s+")  # may differ between runs: numbers and padding
PROGRAM: Any = typer.main.get_command(app)
COMMANDS = PROGRAM.commands


def run(command: list[str], folder: Path) -> str:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = captured(*command, cwd=folder, env={**os.environ, "PATH": path}, timeout=600)
    assert done.returncode == 0, f"{command[-1]}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def run_shell(script: str, folder: Path) -> str:
    """Run a script, and then in this process the slipflow commands in it, which saves their imports."""
    if re.search(r"^export ", script, re.MULTILINE):  # a setting of the process
        return run(["bash", "-euc", script], folder)
    expanded = "slipflow() { printf 'slipflow'; printf '\\t%s' \"$@\"; echo; }\n" + script
    printed = ""
    for line in run(["bash", "-euc", expanded], folder).splitlines():
        assert line.startswith("slipflow\t")
        printed += succeed(*line.split("\t")[1:], cwd=folder).stdout
    return printed


def same_but_for_numbers(line: str) -> str:
    return SHOWN.sub(" ", line).strip()


@pytest.mark.parametrize("name", RUN)
def test_every_block_runs_in_order_and_prints_the_text_on_the_page(name: str, tmp_path: Path) -> None:
    printed, ran = "", 0
    for block in blocks(ROOT / "docs" / name):
        if block.language == "python" and block.name.endswith(".py"):
            (tmp_path / block.name).write_text(block.body)
        elif block.language == "python" and not block.name:
            printed, ran = run([sys.executable, "-c", block.body], tmp_path), ran + 1
        elif block.language == "sh":
            printed, ran = run_shell(block.body, tmp_path), ran + 1
        elif block.language == "json":
            json.loads(block.body)
        elif block.language == "text" and printed:
            assert name not in EXACT or printed.endswith(block.body), printed
            lines = {same_but_for_numbers(line) for line in printed.splitlines()}
            assert {same_but_for_numbers(line) for line in block.body.splitlines()} <= lines, printed
    assert ran or name == "reference/mqtt.md"  # tests/test_docs_mqtt.py runs its files


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_of_python_compiles(page: Path) -> None:
    for block in blocks(page):
        if block.language == "python":
            compile(block.body, page.name, "exec")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_command_is_valid_in_code_and_exists_with_its_options_in_prose(page: Path) -> None:
    for name, *rest in commands(page):
        COMMANDS[name].make_context(f"slipflow {name} {' '.join(rest)}", rest)  # raises an error if it is not
    for name, *rest in mentioned(page):
        options = {word for each in COMMANDS[name].params for word in (*each.opts, *each.secondary_opts)}
        assert {word for word in rest if word.startswith("-")} <= options, name


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and MkDocs make them."""
    prose = re.sub(r"(?ms)^```.*?^```", "", page.read_text())
    headings = re.findall(r"(?m)^#+ (.+)$", prose)
    return {re.sub(r"[^\w -]", "", each.lower()).replace(" ", "-") for each in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_has_its_target_and_its_heading(page: Path) -> None:
    for target, _, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(#([^)]+))?\)", page.read_text()):
        linked = page.parent / target if target else page
        assert linked.exists(), target
        assert not anchor or anchor in anchors(linked), f"{target}#{anchor}"


@pytest.mark.parametrize("name", GENERATED)
def test_the_generated_page_is_up_to_date(name: str) -> None:
    assert (FOLDER / name).read_text() == GENERATED[name](), "run `make docs`"


def test_the_navigation_of_the_site_names_every_page_once() -> None:
    named = re.findall(r"(?m)^ +- (?:.+: )?(\S+\.md)$", (ROOT / "mkdocs.yml").read_text())
    docs = ROOT / "docs"
    assert sorted(named) == sorted(str(page.relative_to(docs)) for page in docs.rglob("*.md"))
