"""Commands that are imported when they are first used; help in panels; usage errors in one line."""

import re
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from functools import cache
from importlib import import_module
from inspect import getdoc
from typing import TYPE_CHECKING, Any, ClassVar, Final, cast

import typer
import typer.main
from typer.core import TyperGroup

if TYPE_CHECKING:
    from typer._click import Command, Context, HelpFormatter


_MODULES: Final = {"demo": "demo_command", "import": "import_command"}  # else the name of the command


class CommandTable(Mapping[str, "Command"]):
    """Commands by name, imported when they are first used.

    Args:
        panels: Summaries of the commands by name, in panels, in the order of the help.
    """

    def __init__(self, panels: Mapping[str, Mapping[str, str]]) -> None:
        self.panels = panels
        self.summaries = {name: text for panel in panels.values() for name, text in panel.items()}

    def __getitem__(self, name: str) -> "Command":
        if name not in self.summaries:
            raise KeyError(name)
        return _command(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.summaries)

    def __len__(self) -> int:
        return len(self.summaries)


class PanelGroup(TyperGroup):
    """A group whose help lists its commands by panel, without importing them."""

    table: ClassVar[CommandTable]

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = cast("MutableMapping[str, Command]", self.table)  # which typer only reads

    def format_commands(self, ctx: "Context", formatter: "HelpFormatter") -> None:
        """Write a section for each panel."""
        for panel, summaries in self.table.panels.items():
            with formatter.section(panel):
                formatter.write_dl([*summaries.items()], col_max=max(map(len, self.table)))


def command_group(text: str, table: CommandTable) -> typer.Typer:
    """Make the group of the commands in a table; `text` is its help."""
    group = type("Group", (PanelGroup,), {"table": table})
    return typer.Typer(
        cls=group, help=text, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None
    )


@cache
def _command(name: str) -> "Command":
    """Import a command; its docstring is the help, whose lines below ``Examples:`` are not wrapped."""
    commands = import_module(f"flows.cli.{_MODULES.get(name, name)}")
    function: Callable[..., Any] = getattr(commands, name, None) or getattr(commands, f"{name}_")
    text, _, lines = (getdoc(function) or "").partition("Examples:\n")
    epilog = f"\b\nExamples:\n{lines}"  # \b: no line is wrapped up to the next empty one
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command(name, help=text.rstrip(), epilog=epilog)(function)
    return typer.main.get_command(app)


def usage_error(error: typer.TyperException) -> str:
    """Return one line with the error and the command for help, or the whole help if no command was given.

    >>> usage_error(typer.BadParameter("--surface cube: give plane or sphere"))
    'error: --surface cube: give plane or sphere'
    """
    text = error.format_message()
    if text.startswith("Usage: "):
        return text
    if type(error) is typer.BadParameter and error.param is None:  # raised by a command: complete as it is
        return f"error: {_one_line(error.message)}"
    text = (
        _one_line(text).removesuffix(".").replace("Value error, ", "").replace("Input should be", "must be")
    )
    text = re.sub(r", unable to parse string as an? \w+$", "", text)
    text = re.sub(r" \(Possible options: (.*)\)$", r". Did you mean \1?", text)
    text = text[0].lower() + text[1:]
    context = getattr(error, "ctx", None)  # some errors have no context, which names the command
    if context is not None:
        text += f"{'' if text.endswith('?') else '.'} See {context.command_path} --help"
    return f"error: {text}"


def _one_line(text: str) -> str:
    return " ".join(text.split())
