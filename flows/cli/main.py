"""The command line: `slipflow`."""

import errno
import os
import re
import sys
import traceback
from contextlib import suppress
from inspect import getdoc
from pathlib import Path
from typing import Annotated, Final, NoReturn

import typer

from flows.cli.calibrate import calibrate
from flows.cli.check import check
from flows.cli.collect import collect
from flows.cli.demo_command import demo
from flows.cli.doctor import doctor
from flows.cli.evaluate import evaluate
from flows.cli.experiment import experiment
from flows.cli.export import export
from flows.cli.fetch import fetch
from flows.cli.import_command import import_
from flows.cli.run import run
from flows.cli.show import show
from flows.cli.simulate import simulate
from flows.cli.terminal import note
from flows.cli.train import train
from flows.cli.verify import verify
from flows.cli.watch import watch

app = typer.Typer(
    help="Detect slip from barometric fingertips: run flows, record datasets, train detectors.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
COMMANDS: Final = (
    run, demo, check, doctor, show, watch, train, calibrate, evaluate, collect, experiment,
    verify, fetch, import_, export, simulate,
)  # fmt: skip
for function in COMMANDS:
    text, _, lines = (getdoc(function) or "").partition("Examples:\n")
    epilog = f"\b\nExamples:\n{lines}"  # \b: no line is wrapped up to the next empty one
    app.command(function.__name__.rstrip("_"), help=text.rstrip(), epilog=epilog)(function)
_OUTPUT_ERRORS: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF}
_NO_MEMORY: Final = ("failed to map segment", "cannot allocate memory", "can't start new thread")
_SMALL: Final = {"numba", "polars", "scipy"}  # a small installation lacks them, see deploy/edge.txt
_debug = False


def _print_version(value: bool) -> None:
    if value:
        from importlib.metadata import version

        typer.echo(f"slipflow {version('slipflow')}")
        raise typer.Exit


@app.callback()
def _options(
    *,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version)
    ] = False,
) -> None:
    global _debug  # noqa: PLW0603 - main() reports errors after the command has returned
    _debug = debug
    try:
        Path.cwd()
    except OSError:
        from operators.errors import InputError

        raise InputError("the current folder", "was deleted or may not be read: change to another") from None


def main() -> NoReturn:
    """Run the command line; an error that the user can fix is one line and exit code 2."""
    try:
        code = app(standalone_mode=False, prog_name="slipflow")
        if sys.stdout:
            sys.stdout.flush()
    except KeyboardInterrupt:
        code = 130
    except Exception as error:
        code, text = explanation(error)
        if not code:
            raise
        if _debug:
            traceback.print_exc()
        elif text:
            with suppress(OSError):
                note(text)
        if _lacks_memory(error):
            _close_output()
            os._exit(code)  # libraries may crash while they end
    _close_output()
    sys.exit(code)


def explanation(error: Exception) -> tuple[int, str]:
    """Return the exit code and the line that explain an error to the user; 0 for an error in slipflow."""
    if _lacks_memory(error):  # before any import
        return 2, "error: there is not enough memory"
    from operators.errors import OutputClosedError, SlipflowError, os_error_reason

    if isinstance(error, typer.Abort) or _interrupted(error):
        return 130, ""
    if isinstance(error, typer.TyperException):
        return 2, usage_error(error)
    if isinstance(error, BrokenPipeError | OutputClosedError):  # `slipflow ... | head`
        return 1, ""
    if isinstance(error, SlipflowError):
        text = str(error)
    elif isinstance(error, OSError) and (error.filename is not None or error.errno in _OUTPUT_ERRORS):
        text = f"{error.filename or 'standard output'}: {os_error_reason(error)}"
    elif isinstance(error, ModuleNotFoundError) and error.name and error.name.partition(".")[0] in _SMALL:
        package = error.name.partition(".")[0]
        text = f"{package} is not installed: {sys.executable} -m pip install {package}"
    else:
        return 0, ""
    return 2, f"error: {text}"


def _lacks_memory(error: Exception) -> bool:
    """Return true for an error that a lack of memory has caused, also in an import or by a new thread."""
    text = f"{error} {error.__cause__}".lower()
    return isinstance(error, MemoryError) or any(each in text for each in _NO_MEMORY)


def _interrupted(error: BaseException | None) -> bool:
    """Return True if Ctrl-C caused an error, such as an ImportError of an extension that it interrupted."""
    return error is not None and (isinstance(error, KeyboardInterrupt) or _interrupted(error.__context__))


def _close_output() -> None:
    """Discard output that cannot be written, so that Python does not try again at exit."""
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


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
    if text.startswith("no such option: --debug."):
        text = "--debug stands before the command: slipflow --debug COMMAND ..."
    return f"error: {text}"


def _one_line(text: str) -> str:
    return " ".join(text.split())
