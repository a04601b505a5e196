"""The command line: `slipflow`."""

import sys
from typing import Annotated

import typer

from flows.cli import datasets, detectors, exchange, experiments
from flows.cli.check import check, graph
from flows.cli.collect import collect
from flows.cli.demo import demo
from flows.cli.examples import examples
from flows.cli.mistakes import mistake
from flows.cli.rig import rig
from flows.cli.run import run
from flows.cli.show import show
from flows.cli.watch import watch

app = typer.Typer(
    help="Feel slip: run declared flows from barometric fingertips to slip events and labelled datasets.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_debug = False


@app.callback()
def _options(
    *, debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False
) -> None:
    global _debug  # noqa: PLW0603 - main() shows the error after the command has gone
    _debug = debug


def main() -> None:
    """Run the command line; an error that the user can mend is one line and exit code 2."""
    try:
        sys.exit(app(standalone_mode=False, prog_name="slipflow"))
    except typer.TyperException as error:
        if _debug:
            raise
        typer.echo(mistake(error), err=True)
        sys.exit(2)
    except OSError as error:
        if _debug or error.filename is None:
            raise
        from operators.errors import os_error_reason  # noqa: PLC0415 - loads numpy, which `slipflow --help` need not

        typer.echo(f"error: {error.filename}: {os_error_reason(error)}", err=True)
        sys.exit(2)
    except Exception as error:
        from operators.errors import SlipflowError  # noqa: PLC0415 - loads numpy, which `slipflow --help` need not

        if _debug or not isinstance(error, SlipflowError):
            raise
        typer.echo(f"error: {error}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


for each in (
    run,
    check,
    graph,
    demo,
    detectors.train,
    detectors.evaluate,
    detectors.chart,
    detectors.stress,
    detectors.onnx,
    datasets.verify,
    datasets.recover,
    collect,
    rig,
    exchange.export,
    show,
    datasets.simulate,
    watch,
):
    app.command(epilog=examples(each.__name__))(each)
app.command("import", epilog=examples("import"))(exchange.import_)
app.add_typer(experiments.app, name="experiment")
