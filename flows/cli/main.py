"""The command line: `slipflow`."""

import sys
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated, Final

import typer

from flows.cli import experiments
from flows.cli.chart import chart
from flows.cli.check import check
from flows.cli.collect import collect
from flows.cli.commands import command_group, register, usage_error
from flows.cli.demo_command import demo
from flows.cli.evaluate import evaluate
from flows.cli.export import export
from flows.cli.graph import graph
from flows.cli.import_command import import_
from flows.cli.onnx import onnx
from flows.cli.recover import recover
from flows.cli.rig import rig
from flows.cli.run import run
from flows.cli.show import show
from flows.cli.simulate import simulate
from flows.cli.stress import stress
from flows.cli.train import train
from flows.cli.verify import verify
from flows.cli.watch import watch

app = command_group("Detect slip from barometric fingertips: run flows, record datasets, train detectors.")
_PANELS: Final[Mapping[str, Sequence[Callable[..., None]]]] = MappingProxyType(
    {
        "Record and run": (run, demo, check, graph),
        "View": (show, watch),
        "Train and evaluate": (train, evaluate, chart, stress, onnx),
        "Robots": (collect, rig),
        "Data": (verify, recover, import_, export, simulate),
    }
)
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


def main() -> None:
    """Run the command line; an error that the user can fix is one line and exit code 2."""
    try:
        sys.exit(app(standalone_mode=False, prog_name="slipflow"))
    except typer.TyperException as error:
        if _debug:
            raise
        typer.echo(usage_error(error), err=True)
        sys.exit(2)
    except OSError as error:
        if _debug or error.filename is None:
            raise
        from operators.errors import os_error_reason

        typer.echo(f"error: {error.filename}: {os_error_reason(error)}", err=True)
        sys.exit(2)
    except Exception as error:
        from operators.errors import SlipflowError

        if _debug or not isinstance(error, SlipflowError):
            raise
        typer.echo(f"error: {error}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


for panel, commands in _PANELS.items():
    for command in commands:
        register(app, command, panel)
app.add_typer(experiments.app, name="experiment", rich_help_panel="Robots")
