"""The command line: `slipflow`."""

import errno
import os
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from types import MappingProxyType
from typing import Annotated, Final, NoReturn

import typer

from flows.cli import experiments
from flows.cli.adapt import adapt
from flows.cli.benchmark import benchmark
from flows.cli.calibrate import calibrate
from flows.cli.chart import chart
from flows.cli.check import check
from flows.cli.collect import collect
from flows.cli.commands import command_group, register, usage_error
from flows.cli.demo_command import demo
from flows.cli.doctor import doctor
from flows.cli.evaluate import evaluate
from flows.cli.export import export
from flows.cli.fetch import fetch
from flows.cli.graph import graph
from flows.cli.import_command import import_
from flows.cli.model_list import models
from flows.cli.onnx import onnx
from flows.cli.prune import prune
from flows.cli.recover import recover
from flows.cli.rig import rig
from flows.cli.run import run
from flows.cli.show import show
from flows.cli.simulate import simulate
from flows.cli.stress import stress
from flows.cli.terminal import note
from flows.cli.train import train
from flows.cli.verify import verify
from flows.cli.watch import watch

app = command_group("Detect slip from barometric fingertips: run flows, record datasets, train detectors.")
_PANELS: Final[Mapping[str, Sequence[Callable[..., None]]]] = MappingProxyType(
    {
        "Record and run": (run, demo, check, doctor, graph),
        "View": (show, watch),
        "Train and evaluate": (train, adapt, calibrate, evaluate, benchmark, chart, stress, models, onnx),
        "Robots": (collect, rig),
        "Data": (verify, recover, prune, fetch, import_, export, simulate),
    }
)
_OUTPUT_ERRORS: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF}
_debug = False


def _print_version(value: bool) -> None:  # noqa: FBT001 - called by typer
    if value:
        from importlib.metadata import version

        typer.echo(f"slipflow {version('slipflow')}")
        raise typer.Exit


@app.callback()
def _options(
    *,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[  # noqa: ARG001 - its callback prints it
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version)
    ] = False,
) -> None:
    global _debug  # noqa: PLW0603 - main() reports errors after the command has returned
    _debug = debug


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
    _close_output()
    sys.exit(code)


def explanation(error: Exception) -> tuple[int, str]:
    """Return the exit code and the line that explain an error to the user; 0 for an error in slipflow."""
    from operators.errors import OutputClosedError, SlipflowError, os_error_reason

    if isinstance(error, typer.Abort) or _interrupted(error):
        return 130, ""
    if isinstance(error, typer.TyperException):
        return 2, usage_error(error)
    if isinstance(error, BrokenPipeError | OutputClosedError):  # `slipflow ... | head`
        return 1, ""
    if isinstance(error, SlipflowError) or (type(error) is RuntimeError and "Symlink loop" in str(error)):
        return 2, f"error: {error}"
    if isinstance(error, OSError) and (error.filename is not None or error.errno in _OUTPUT_ERRORS):
        return 2, f"error: {error.filename or 'standard output'}: {os_error_reason(error)}"
    text = "there is not enough memory" if isinstance(error, MemoryError) else _missing_package(error)
    return (2, f"error: {text}") if text else (0, "")


def _missing_package(error: Exception) -> str:
    """Return how to install a missing package that slipflow needs; empty if that is not the error."""
    from operators.extras import requirements

    if isinstance(error, ModuleNotFoundError):
        package = (error.name or "").partition(".")[0]
        if package in {each.package for each in requirements() if not each.extra}:
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


for panel, commands in _PANELS.items():
    for command in commands:
        register(app, command, panel)
app.add_typer(experiments.app, name="experiment", rich_help_panel="Robots")
