"""Registration of commands: help with panels and examples, and usage errors in one line."""

import re
from collections.abc import Callable
from inspect import getdoc
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperGroup

if TYPE_CHECKING:
    from typer._click import Context, HelpFormatter


class PanelGroup(TyperGroup):
    """A group of commands whose help lists them by panel."""

    def format_commands(self, ctx: "Context", formatter: "HelpFormatter") -> None:
        """Write a section for each panel, in the order of registration."""
        width = formatter.width - 6 - max(map(len, self.commands))
        panels = dict[str, list[tuple[str, str]]]()
        for name in self.list_commands(ctx):
            command = self.commands[name]
            panel = getattr(command, "rich_help_panel", None) or "Commands"
            panels.setdefault(str(panel), []).append((name, command.get_short_help_str(width)))
        for panel, rows in panels.items():
            with formatter.section(panel):
                formatter.write_dl(rows, col_max=max(map(len, self.commands)))


def command_group(text: str) -> typer.Typer:
    """Return a group of commands with the help `text`."""
    return typer.Typer(
        cls=PanelGroup,
        help=text,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )


def register(app: typer.Typer, function: Callable[..., Any], panel: str | None = None) -> None:
    """Register a function as the command of the same name.

    Its docstring is the help; the lines below ``Examples:`` are not wrapped.
    """
    text, _, lines = (getdoc(function) or "").partition("Examples:\n")
    epilog = f"\b\nExamples:\n{lines}"  # \b: no line is wrapped up to the next empty one
    name = function.__name__.rstrip("_")
    app.command(name, help=text.rstrip(), epilog=epilog, rich_help_panel=panel)(function)


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
