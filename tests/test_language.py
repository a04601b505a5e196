"""Rules for the project's text: docstrings, comments, messages, option helps and pages."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import typer.core
import typer.main

from flows.cli.main import app

ROOT: Final = Path(__file__).parents[1]
FOLDERS: Final = ("operators", "connectors", "storage", "flows", "deploy")

FIRST_WORDS: Final = re.compile(r"(What|How|Whether|That|Where|Who|When|Which|Whose)\b")
# Words and phrases with a plainer term; the reason or the term is the second part.
AVOID: Final = {
    r"told|tells?": "log, report, print, state",
    r"beside": "next to, with",
    r"nobody|somebody": "no one, a person, a user, a process",
    r"anew": "again, a new one",
    r"whose turn": "the next",
    r"(un)?feels?|(un)?felt": "detect, measure, contact",
    r"house|hall": "module, package, project",
    r"unfold(s|ed|ing)?": "compile",
    r"outlets?": "sink queue, worker",
    r"incidents?": "log event",
    r"laws?": "invariant, rule",
    r"lonely": "exclusive",
    r"whoever|whosoever|whatsoever": "the user, the caller",
    r"is sound": "OK",
    r"is what it (is|says|was)": "name it",
    r"an own|(?:its|their) begin": "one's own; beginning",
    r"a MCAP": "an MCAP file",
    r"(?:in|is|has|with) another [a-z]+ than": "a different ... from, a ... other than",
    r"the one before|the ones before": "the previous one",
    r"(?:synchron|general|random|standard|recogn)iz\w+": "-ise, as everywhere else",
    r"(?<!there )is no (?!longer|more|less|such|better|worse)[a-z]+": "is not a",
}
# Uses of these words that are correct: the text around the word, and why.
ALLOWED: Final = {
    r"Hooke's law|Coulomb's law|power law|law of \w+": "laws of physics and mathematics",
}

_AVOIDED: Final = re.compile("|".join(rf"\b(?:{words})\b" for words in AVOID), re.IGNORECASE)
_PERMITTED: Final = re.compile("|".join(ALLOWED), re.IGNORECASE)
_NOT_PROSE: Final = re.compile(r"^[\w./:{}%*<>\[\]-]*$")  # names, keys and paths: strings without a space

MODULES: Final = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))
WEB: Final = sorted(
    path
    for path in (ROOT / "connectors" / "web" / "static").iterdir()
    if path.suffix in (".js", ".html", ".css")
)
PAGES: Final = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the line and text of each docstring."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield getattr(node, "lineno", 1), text


def texts(source: str) -> Iterator[tuple[int, str]]:
    """Yield the line and text of each comment and each string with a space."""
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Constant(value=str(text), lineno=line) if not _NOT_PROSE.match(text):
                yield line, text
            case _:
                pass


def avoided(text: str) -> list[str]:
    """Return the words of a text that are to be avoided."""
    return [found[0] for found in _AVOIDED.finditer(_PERMITTED.sub("", text))]


def options(command: Any, name: str = "slipflow") -> Iterator[tuple[str, str]]:  # noqa: ANN401 - click's types
    """Yield the name and help of each option of a command and of those below it."""
    for parameter in command.params:
        if getattr(parameter, "help", None):
            yield f"{name} {parameter.name}", parameter.help
    if isinstance(command, typer.core.TyperGroup):
        for each, below in command.commands.items():
            yield from options(below, f"{name} {each}")


def test_a_docstring_starts_with_a_verb_or_a_noun() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text.splitlines()[0]}"
        for path in MODULES
        for line, text in docstrings(ast.parse(path.read_text()))
        if FIRST_WORDS.match(text)
    ]
    assert found == []


def test_docstrings_comments_and_messages_use_plain_words() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {', '.join(words)}"
        for path in MODULES
        for line, text in texts(path.read_text())
        if (words := avoided(text))
    ]
    assert found == []


def test_pages_use_plain_words() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {', '.join(words)}"
        for path in [*WEB, *PAGES]
        for line, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if (words := avoided(text))
    ]
    assert found == []


def test_the_help_of_an_option_states_its_effect() -> None:
    found = options(typer.main.get_command(app))
    assert [
        each for each in found if re.match(r"(Of|As|By|What|How|Whether|That|Where|Without)\b", each[1])
    ] == []


def test_avoided_words_are_found_and_allowed_uses_are_not() -> None:
    assert avoided("Rows that somebody told of, felt anew") == ["somebody", "told", "felt", "anew"]
    assert avoided("an own file, in another order than a MCAP file") == [
        "an own",
        "in another order than",
        "a MCAP",
    ]
    assert avoided("an MCAP file of one's own, at the beginning") == []
    assert avoided("The power law of friction; telling, household, lawn") == []
    source = 'def f():\n    """What it is."""\n    raise E("is told")  # nobody\n'
    assert [words for _, text in texts(source) if (words := avoided(text))] == [["nobody"], ["told"]]
    assert [text for _, text in docstrings(ast.parse(source)) if FIRST_WORDS.match(text)] == ["What it is."]
