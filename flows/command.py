"""The command line: `slipflow`."""

import asyncio
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows import (
    cluster_commands,
    collect_command,
    dataset_commands,
    detector_commands,
    exchange_commands,
    experiment_commands,
    replay_commands,
    rig_command,
    show_commands,
    watch_command,
)
from flows.cluster_commands import Follow, OnCluster, WithPython
from flows.event_log import Format, Log, begin_log, in_json, logged
from flows.examples import examples
from flows.live_metrics import WithMetrics, add_metrics
from flows.live_page import Listen, NoBrowser, WithPage, add_page
from flows.mistakes import mistake
from flows.options import AsJson, told

if TYPE_CHECKING:
    from collections.abc import Sequence

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
        help="A Python file that declares a flow (run as code), or one of live, record, relabel, lift.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Set a parameter of the flow, as delay=70ms; `slipflow check` lists them; may be given several"
        " times.",
    ),
]
Duration = Annotated[
    str | None, typer.Option("--for", metavar="TIME", help="Stop after this time: 500ms, 30s, 5min, 1h.")
]


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
        typer.echo(f"error: {error.filename}: {error.strerror}", err=True)
        sys.exit(2)
    except Exception as error:
        from operators.errors import SlipflowError

        if _debug or not isinstance(error, SlipflowError):
            raise
        typer.echo(f"error: {error}", err=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


@app.command(epilog=examples("run"))
def run(
    target: Target,
    *,
    settings: Settings = None,
    duration: Duration = None,
    replay: Annotated[
        list[Path] | None,
        typer.Option(metavar="PATH", help="Run over a session, all of a dataset or a CSV trace instead."),
    ] = None,
    more: Annotated[
        list[Path] | None, typer.Argument(metavar="PATH", help="With --replay: further recordings.")
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Processes that replay recordings; one for each core by default."),
    ] = None,
    pace: Annotated[
        float | None,
        typer.Option(
            min=0.01, help="Replay at this multiple of real time, 1 as it came; else at full speed."
        ),
    ] = None,
    cluster: OnCluster = None,
    python: WithPython = None,
    follow: Follow = False,
    page: WithPage = False,
    listen: Listen = None,
    no_browser: NoBrowser = False,
    metrics: WithMetrics = None,
    log: Log = Format.TEXT,
    as_json: AsJson = False,
) -> None:
    """Run a flow: live, or over a recording with --replay.

    Ends when its sources end, after --for, or at Ctrl-C, and commits what it took; exits 1 if a source was
    down at the end or rows were lost.

    Several recordings are replayed side by side, each to a session of its own, its lines below its name; one
    that fails is reported, the others go on, and it exits 1.

    With --json a live run is one object: session, flow, seconds, sources, sinks, error. A replay, of one
    recording or of many, is {"sessions": [...], "wall_seconds": ...}, with that and "recording" for each.
    """
    from time import perf_counter

    from flows.parallel_replay import apart, open_recording, recordings
    from flows.quantity import time

    limit = None if duration is None else time("run", "--for", duration)  # ns
    flow = _flow(target, settings)
    if replay is None and (pace is not None or jobs is not None or more):
        raise typer.BadParameter(
            "--pace, --jobs and further recordings need --replay PATH: without it a flow runs live"
        )
    if not cluster:
        _check_replay(
            full_speed=bool(replay) and pace is None, timed=bool(duration), clustered=bool(follow or python)
        )
    given = [*(replay or ()), *(more or ())]
    if cluster:
        if metrics or log is not Format.TEXT:
            raise typer.BadParameter(
                "--metrics and --log are of a run on this machine: leave them out with --cluster"
            )
        at = cluster_commands.Place(cluster, python, follow=follow, limit=limit)
        at.run(target, _settings(settings), given, _session(flow), as_json=as_json)
        return
    paths = recordings(given)
    apart(flow, paths)
    if len(paths) > 1:
        if pace is not None or page or listen or metrics or log is not Format.TEXT:
            raise typer.BadParameter(
                "--pace, --page, --metrics and --log take one recording: leave them out, or give one"
            )
        replay_commands.replay(target, _settings(settings), paths, _session(flow), jobs, in_json=as_json)
        return
    recording = open_recording(paths[0], told) if paths else None
    if log is Format.JSON:
        flow = in_json(flow)
    if page or listen:
        add_page(flow, listen, browse=not no_browser)
    if metrics:
        add_metrics(flow, metrics)
    began = perf_counter()
    done = asyncio.run(_execute(flow, recording, limit, pace, log))
    _finish(done, paths, perf_counter() - began, log, as_json=as_json)


@app.command(epilog=examples("check"))
def check(target: Target, *, settings: Settings = None, as_json: AsJson = False) -> None:
    """Find what is wrong with a flow without running it.

    Lists its parameters with their defaults, ready for --set. Exits 2 if anything is wrong.
    """
    from flows.loading import load
    from flows.validate import problems

    declaration = load(target)
    flow = declaration.flow(_settings(settings))
    found = [str(problem) for problem in problems(flow)]
    if as_json:
        parameters = {name: each.as_dict() for name, each in declaration.parameters.items()}
        typer.echo(json.dumps({"flow": flow.name, "problems": found, "parameters": parameters}))
    elif found:
        typer.echo("\n".join(f"error: {problem}" for problem in found), err=True)
    else:
        typer.echo(f"{flow.name} is sound; sources: {_names(flow.sources())}; sinks: {_names(flow.sinks())}")
        for each in declaration.parameters.values():
            typer.echo(f"  --set {each}")
    if found:
        raise typer.Exit(2)


@app.command(epilog=examples("graph"))
def graph(
    target: Target,
    *,
    settings: Settings = None,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As a Mermaid flowchart.")] = False,
    svg: Annotated[bool, typer.Option("--svg", help="As an SVG picture.")] = False,
) -> None:
    """Draw a flow: as text, --mermaid or --svg."""
    from flows import diagram, drawing

    if svg and mermaid:
        raise typer.BadParameter("--svg and --mermaid: give one of them")
    flow = _flow(target, settings)
    typer.echo(diagram.svg(flow) if svg else drawing.mermaid(flow.nodes) if mermaid else flow)


@app.command(epilog=examples("demo"))
def demo(
    *,
    duration: Duration = "20s",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Dataset to record into.")] = Path("recordings"),
    mqtt: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Publish to this broker; without, to one found on localhost."),
    ] = None,
    rig: Annotated[
        str, typer.Option(metavar="NAME", help="What it is called in topics; each its own outbox.")
    ] = "demo",
    outbox: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Keeps the events for the broker; by default one for each rig."),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of all noise of the simulated rig.")] = 0,
    page: WithPage = True,
    listen: Listen = None,
    no_browser: NoBrowser = False,
    metrics: WithMetrics = None,
    log: Log = Format.TEXT,
    as_json: AsJson = False,
) -> None:
    """Run the main job with nothing attached, on a simulated rig.

    It feels slip, records a labelled dataset, shows both on a page, and publishes events where a broker is.
    Exits 1 if a source was down at the end or rows were lost.
    """
    from flows import demo as demonstration
    from flows.quantity import time
    from flows.summary import Summary

    limit = None if duration is None else time("demo", "--for", duration)  # ns

    broker = mqtt or demonstration.local_broker()
    flow = demonstration.Demo(out, broker=broker, rig=rig, outbox=outbox, seed=seed)
    if log is Format.JSON:
        flow.flow = in_json(flow.flow)
    if page:
        add_page(flow.flow, listen, browse=not no_browser)
    if metrics:
        add_metrics(flow.flow, metrics)
    typer.echo(flow.flow, err=True)
    typer.echo("starting; the first time, the simulated physics is compiled for some seconds", err=True)
    done = asyncio.run(_execute(flow.flow, None, limit, None, log))
    summary = Summary.of(done)
    if as_json:
        typer.echo(json.dumps({**summary.as_dict(), **flow.summary(done)}))
    elif log is Format.TEXT:
        typer.echo(flow.report(done))
    if summary.lost:
        raise typer.Exit(1)


for each in (
    detector_commands.train,
    detector_commands.evaluate,
    detector_commands.chart,
    detector_commands.stress,
    detector_commands.onnx,
    dataset_commands.verify,
    dataset_commands.recover,
    collect_command.collect,
    rig_command.rig,
    exchange_commands.export,
    show_commands.show,
    dataset_commands.simulate,
    watch_command.watch,
):
    app.command(epilog=examples(each.__name__))(each)
app.command("import", epilog=examples("import"))(exchange_commands.import_)
app.add_typer(experiment_commands.app, name="experiment")


def _check_replay(*, full_speed: bool, timed: bool, clustered: bool) -> None:
    """Say which options do not go together on this machine."""
    if clustered:
        raise typer.BadParameter("--follow and --cluster-python need --cluster URL")
    if full_speed and timed:
        raise typer.BadParameter("--for is of live runs and of --pace: a replay ends with its recording")


def _names(nodes: "list[Node]") -> str:
    return ", ".join(node.name for node in nodes)


def _settings(settings: list[str] | None) -> dict[str, str]:
    pairs = [setting.partition("=") for setting in settings or ()]
    for name, equals, _ in pairs:
        if not (name and equals):
            raise typer.BadParameter(f"--set {name}: write it as NAME=VALUE, such as seed=1")
    return {name: value for name, _, value in pairs}


def _flow(target: str, settings: list[str] | None) -> "Flow":
    from flows.loading import load

    return load(target).flow(_settings(settings))


def _session(flow: "Flow") -> str:
    from datetime import UTC, datetime

    return f"{flow.name}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}Z"


async def _execute(
    flow: "Flow", recording: "Recording | None", limit: int | None, pace: float | None, log: Format
) -> "Run":
    from flows.clock import LoopClock
    from flows.live_runner import LiveRunner
    from flows.replay_runner import ReplayRunner, first_time, replayed, tell_places
    from flows.stopping import stopping

    begin_log(log)
    if recording is not None:
        tell_places(flow)
    session = _session(flow)
    if recording is not None and pace is None:
        replay, show = ReplayRunner(flow, recording, session), replay_commands.progress(recording)
        with stopping() as stopped, logged(replay.run):
            return await replay.execute(lambda run: replay.stop() if stopped() else show(run))
    clock = None if recording is None else LoopClock(first_time(recording), pace or 1.0)
    flow = flow if recording is None else replayed(flow, recording)
    live = LiveRunner(flow, session, clock=clock, duration=limit)
    with logged(live.run):
        return await live.execute()


def _finish(run: "Run", replayed: "Sequence[Path]", seconds: float, log: Format, *, as_json: bool) -> None:
    from flows.parallel_replay import Replayed
    from flows.summary import Summary

    summary = Summary.of(run)
    if as_json and replayed:
        [path] = replayed
        typer.echo(replay_commands.as_json([Replayed(str(path), summary, error=run.error)], seconds))
    elif as_json:
        typer.echo(json.dumps(summary.as_dict()))
    elif log is Format.TEXT:  # else the log has told it
        typer.echo(summary.report())
    if run.error:
        told(f"error: {run.error}")
        raise typer.Exit(130)
    if summary.lost:
        raise typer.Exit(1)
