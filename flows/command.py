"""The command line: `slipflow`."""

import asyncio
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from flows import (
    dataset_commands,
    detector_commands,
    exchange_commands,
    experiment_commands,
    rig_commands,
)
from flows.options import AsJson, nanoseconds, progress_bar, told

if TYPE_CHECKING:
    from collections.abc import Callable

    from connectors.events import Event
    from flows.graph import Flow
    from flows.node import Node
    from operators.ports import Recording, Run

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415

app = typer.Typer(
    help="Feel slip: run declared flows from barometric fingertips to slip events and labelled datasets.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_debug = False

Target = Annotated[
    str,
    typer.Argument(
        metavar="FILE[:FLOW]",
        help="A Python file that declares a flow (run as code), or a ready-made one: live, record, lift.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="NAME=VALUE", help="Set a parameter of the flow; may be given several times."
    ),
]
Duration = Annotated[
    str | None, typer.Option("--for", metavar="TIME", help="Stop after this time: 30s, 5min.")
]


@app.callback()
def _options(
    *, debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False
) -> None:
    global _debug  # noqa: PLW0603 - main() shows the error after the command has gone
    _debug = debug


def main() -> None:
    """Run the command line; an error that the user can mend is one line and exit code 2."""
    from operators.errors import SlipflowError

    try:
        app()
    except SlipflowError as error:
        if _debug:
            raise
        typer.echo(f"error: {error}", err=True)
        sys.exit(2)
    except OSError as error:
        if _debug or error.filename is None:
            raise
        typer.echo(f"error: {error.filename}: {error.strerror}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


@app.command()
def run(
    target: Target,
    *,
    settings: Settings = None,
    duration: Duration = None,
    replay: Annotated[
        Path | None, typer.Option(metavar="PATH", help="Run over a recorded session or a CSV trace instead.")
    ] = None,
    pace: Annotated[
        float | None, typer.Option(min=0.01, help="Replay at this multiple of real time, not at full speed.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Run a flow: live, or over a recording with --replay.

    Ends when its sources end, after --for, or at Ctrl-C, and commits what it took; exits 1 if a source was
    down at the end or rows were lost.
    """
    flow = _flow(target, settings)
    if pace is not None and replay is None:
        raise typer.BadParameter("--pace needs --replay")
    recording = None if replay is None else _recording(replay)
    _finish(asyncio.run(_execute(flow, recording, duration, pace)), as_json=as_json)


@app.command()
def check(target: Target, *, settings: Settings = None, as_json: AsJson = False) -> None:
    """Find what is wrong with a flow without running it; exits 2 if anything is."""
    from flows.loading import load
    from flows.validate import problems

    declaration = load(target)
    flow = declaration.flow(_settings(settings))
    found = [str(problem) for problem in problems(flow)]
    if as_json:
        typer.echo(
            json.dumps({"flow": flow.name, "problems": found, "parameters": list(declaration.parameters)})
        )
    elif found:
        typer.echo("\n".join(f"error: {problem}" for problem in found), err=True)
    else:
        typer.echo(f"{flow.name} is sound; sources: {_names(flow.sources())}; sinks: {_names(flow.sinks())}")
        for name, (kind, default) in declaration.parameters.items():
            typer.echo(f"  --set {name}={default}  ({getattr(kind, '__name__', kind)})")
    if found:
        raise typer.Exit(2)


@app.command()
def graph(
    target: Target,
    *,
    settings: Settings = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As a Mermaid flowchart.")] = False,
) -> None:
    """Draw a flow."""
    from flows import drawing

    flow = _flow(target, settings)
    typer.echo(drawing.mermaid(flow.nodes) if mermaid else flow)


@app.command()
def demo(
    *,
    duration: Duration = "20s",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset to record into.")] = Path("recordings"),
    mqtt: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Publish to this broker; without, to one found on localhost."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the simulated rig.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Run the main job with nothing attached: a simulated rig, slip events, a labelled dataset."""
    from flows import demo as demonstration

    flow = demonstration.Demo(out, broker=mqtt or demonstration.local_broker(), seed=seed)
    typer.echo(flow.flow, err=True)
    typer.echo("starting; the first time, the simulated physics is compiled for some seconds", err=True)
    done = asyncio.run(_execute(flow.flow, None, duration, None))
    if as_json:
        typer.echo(json.dumps({**_summary(done), **flow.summary(done)}))
    else:
        typer.echo(flow.report(done))
    _exit_if_lost(done)


@app.command()
def simulate(
    out: Annotated[
        Path | None, typer.Argument(metavar="OUT", help="The dataset's folder, new or empty.")
    ] = None,
    *,
    plan: Annotated[
        str, typer.Option(help="paper: 45 minutes; wide: 30, each on a material of its own; tiny: 2.")
    ] = "paper",
    seed: Annotated[int, typer.Option(help="Of everything random; the same seed gives the same bytes.")] = 0,
    delay: Annotated[
        str, typer.Option(metavar="TIME", help="Label each touch by the arm's motion this much later.")
    ] = "0s",
    jobs: Annotated[int | None, typer.Option(help="Processes; one for each core by default.")] = None,
    report: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Measure the scene instead: a page with figures, in minutes."),
    ] = None,
    judge: Annotated[
        Path | None, typer.Option(metavar="PATH", help="For the report: weights of the paper's TCN.")
    ] = None,
    trace: Annotated[
        Path | None, typer.Option(metavar="PATH", help="For the report: a real trace with labels, as CSV.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a collection plan, split for training and testing, as a labelled dataset."""
    if report is not None:
        from flows.scene_report.measured import Size
        from flows.scene_report.report import write_report

        page = write_report(report, seed=seed, judge=judge, trace=trace, size=Size.of(plan), told=told)
        typer.echo(json.dumps({"page": str(page)}) if as_json else f"written: {page}")
        return
    if out is None:
        raise typer.BadParameter("give OUT, the dataset's folder, or --report DIR")
    from flows import simulate as simulation

    with progress_bar(f"simulating {plan}") as update:
        done = simulation.simulate(
            out,
            plan,
            seed,
            delay=nanoseconds(delay) or 0,
            jobs=jobs,
            progress=update,
        )
    typer.echo(json.dumps(done.summary()) if as_json else done.report())


for each in (
    detector_commands.train,
    detector_commands.evaluate,
    detector_commands.chart,
    detector_commands.stress,
    detector_commands.onnx,
    dataset_commands.verify,
    dataset_commands.recover,
    rig_commands.collect,
    rig_commands.rig,
    exchange_commands.export,
):
    app.command()(each)
app.command("import")(exchange_commands.import_)
app.add_typer(experiment_commands.app, name="experiment")


@app.command()
def watch(
    url: Annotated[str, typer.Argument(metavar="URL", help="The broker.")] = "mqtt://localhost",
    *,
    site: Annotated[str, typer.Option(help="Only this site.")] = "+",
    rig: Annotated[str, typer.Option(help="Only this rig.")] = "+",
    since: Annotated[
        str, typer.Option(help="now: only what happens; start: first all that the rigs still keep.")
    ] = "now",
    remember: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Go on where the watch before with this file was stopped."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print each event as one JSON object.")] = False,
) -> None:
    """Print slip events as a broker delivers them, each once, and ask the rigs for those that were missed.

    Stops at Ctrl-C. What is lost for good is reported, never passed over in silence.
    """
    from contextlib import suppress

    from connectors import Consumer

    if since not in ("now", "start"):
        raise typer.BadParameter("--since: now or start")

    async def show() -> None:
        async with Consumer(
            url, site, rig, remember=remember, since="start" if since == "start" else "now", report=told
        ) as events:
            async for event in events:
                typer.echo(event.encode() if as_json else _line(event))

    with suppress(KeyboardInterrupt):
        asyncio.run(show())


def _line(event: "Event") -> str:
    from connectors.events import timestamp

    where = f"{event.site}/{event.rig} finger {event.finger}"
    sure = "" if event.probability is None else f"  p {event.probability:.2f}"
    doubt = "".join(f"  barometer {fault.barometer} {fault.kind}" for fault in event.degraded)
    when = timestamp(event.time)[:23].replace("T", " ")
    return f"{when}  {where}  slip {event.state:5}{sure}  {event.latency:.1f} ms{doubt}"


def _names(nodes: "list[Node]") -> str:
    return ", ".join(node.name for node in nodes)


def _settings(settings: list[str] | None) -> dict[str, str]:
    pairs = [setting.partition("=") for setting in settings or ()]
    for name, equals, _ in pairs:
        if not equals:
            raise typer.BadParameter(f"--set {name}: write it as NAME=VALUE")
    return {name: value for name, _, value in pairs}


def _flow(target: str, settings: list[str] | None) -> "Flow":
    from flows.loading import load

    return load(target).flow(_settings(settings))


def _recording(path: Path) -> "Recording":
    if path.suffix == ".csv":
        from connectors.csv_trace import CsvTrace

        trace = CsvTrace(path)
        for each in trace.doubts:
            told(f"warning: {path}: {each} (slipflow import knows --units)")
        return trace
    from storage import Session

    return Session.open(path)


async def _execute(
    flow: "Flow", recording: "Recording | None", duration: str | None, pace: float | None
) -> "Run":
    import logging
    from datetime import UTC, datetime

    from flows.clock import LoopClock
    from flows.live_runner import LiveRunner
    from flows.replay_runner import ReplayRunner, first_time, replayed

    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr)
    session = f"{flow.name}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}Z"
    if recording is not None and pace is None:
        return await ReplayRunner(flow, recording, session).execute(_progress(recording))
    clock = None if recording is None else LoopClock(first_time(recording), pace or 1.0)
    flow = flow if recording is None else replayed(flow, recording)
    return await LiveRunner(flow, session, clock=clock, duration=nanoseconds(duration)).execute()


def _progress(recording: "Recording") -> "Callable[[Run], None]":
    """Say how far a replay is, where a person is looking."""
    from rich.console import Console
    from rich.status import Status

    status = Status(f"replaying {recording.name}", console=Console(stderr=True))
    if sys.stderr.isatty():
        status.start()

    def show(run: "Run") -> None:
        rows = sum(source.rows for source in run.sources.values())
        status.update(f"replaying {recording.name}: {(run.clock.now() - run.start) / 1e9:.1f} s, {rows} rows")

    return show


def _summary(run: "Run") -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "session": run.session,
        "flow": run.flow,
        "seconds": (run.clock.now() - run.start) / 1e9,
        "sources": {name: asdict(status) for name, status in run.sources.items()},
        "sinks": {name: asdict(status) for name, status in run.sinks.items()},
    }


def _finish(run: "Run", *, as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(_summary(run)))
    else:
        typer.echo(f"{run.session}: {(run.clock.now() - run.start) / 1e9:.1f} s")
        for name, source in run.sources.items():
            gaps = f"{len(source.gaps)} gaps {source.error}".rstrip()
            typer.echo(f"  {name}: {source.rows} rows in, {source.late} late, {gaps}")
        for name, sink in run.sinks.items():
            typer.echo(f"  {name}: {sink.rows} rows out, {sink.dropped} dropped {sink.error}".rstrip())
    _exit_if_lost(run)


def _exit_if_lost(run: "Run") -> None:
    lost = any(sink.dropped or sink.error for sink in run.sinks.values())
    if lost or any(source.error for source in run.sources.values()):
        raise typer.Exit(1)
