"""The command line: `slipflow`."""

import errno
import os
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Final, NoReturn

import typer

from flows.cli.commands import CommandTable, command_group, usage_error
from flows.cli.terminal import note

TABLE: Final = CommandTable(  # with the first sentences of the functions' docstrings
    {
        "Record and run": {
            "run": "Run a flow live, or replay recordings through it.",
            "demo": "Detect slip on a simulated rig; no hardware is needed.",
            "check": "Find errors in a flow without running it, and draw it.",
            "doctor": "Check this machine, and the devices that a flow uses.",
        },
        "View": {
            "show": "Show a recorded session in a browser, and label it by hand.",
            "watch": "Print slip events from an MQTT broker, each once.",
        },
        "Train and evaluate": {
            "train": "Train a slip detector.",
            "calibrate": "Tune the debounce for a stated rate of false alarms.",
            "evaluate": "Compare detectors on a dataset.",
        },
        "Robots": {
            "collect": "Drive an arm through a collection plan and record it.",
            "experiment": "Run a robot experiment of the paper in closed loop, simulated.",
        },
        "Data": {
            "verify": "Read all files of a dataset and report losses and damage.",
            "fetch": "Download, verify and import a public dataset of real touch.",
            "import": "Import CSV or Parquet files of any fingertip as sessions.",
            "export": "Export recordings to LeRobot or MCAP, or a model to ONNX.",
            "simulate": "Simulate a collection plan as a labelled dataset.",
        },
    }
)
app = command_group(
    "Detect slip from barometric fingertips: run flows, record datasets, train detectors.", TABLE
)
_OUTPUT_ERRORS: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF}
_NO_MEMORY: Final = ("failed to map segment", "cannot allocate memory", "can't start new thread")
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
    if isinstance(error, SlipflowError) or (type(error) is RuntimeError and "Symlink loop" in str(error)):
        text = str(error)
    elif isinstance(error, OSError) and (error.filename is not None or error.errno in _OUTPUT_ERRORS):
        text = f"{error.filename or 'standard output'}: {os_error_reason(error)}"
    else:
        text = _missing_package(error)
    return (2, f"error: {text}") if text else (0, "")


def _lacks_memory(error: Exception) -> bool:
    """Return true for an error that a lack of memory has caused, also in an import or by a new thread."""
    text = f"{error} {error.__cause__}".lower()
    return isinstance(error, MemoryError) or any(each in text for each in _NO_MEMORY)


def _missing_package(error: Exception) -> str:
    """Return how to install a missing package that slipflow needs; empty if that is not the error."""
    if isinstance(error, ModuleNotFoundError):
        package = (error.name or "").partition(".")[0]
        if package in {"numba", "polars", "scipy"}:  # a small installation lacks them, see deploy/edge.txt
            return f"{package} is not installed: {sys.executable} -m pip install {package}"
    return ""


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
