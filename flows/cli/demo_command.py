"""The command `slipflow demo`."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.event_log import Format, begin_log
from flows.cli.execution import execute
from flows.cli.live_view import add_page
from flows.cli.options import NoBrowser, Recordings
from flows.cli.terminal import note

if TYPE_CHECKING:
    from operators import Run


def demo(
    *,
    duration: Annotated[
        str, typer.Option("--for", metavar="TIME", help="Stop after this time, such as 30s or 5min.")
    ] = "20s",
    out: Recordings = Path("recordings"),
    mqtt: Annotated[
        str | None, typer.Option(metavar="URL", help="Publish the slip events to this MQTT broker.")
    ] = None,
    no_browser: NoBrowser = False,
) -> None:
    """Detect slip on a simulated rig; no hardware is needed.

    Records a labelled dataset, shows touch and slips on the live page, and compares the detected slips with
    the true ones. Exits 1 if a source was down or silent at the end, or rows were lost. `slipflow run demo`
    runs the same flow with all options of `run`.

    Examples:
      slipflow demo --for 1min
      slipflow demo --mqtt mqtt://localhost
    """
    from connectors.punctual_loop import run_punctually
    from flows import demo as declared
    from flows.graph.quantity import parse_time
    from flows.run.run_summary import Summary

    begin_log(Format.TEXT)
    limit = parse_time("demo", "--for", duration)  # ns
    flow = declared.demo(str(out), mqtt)
    add_page(flow, browse=not no_browser)
    typer.echo(flow, err=True)
    done = run_punctually(execute(flow, limit=limit))
    typer.echo("\n".join(report(done, out)))
    if mqtt:
        typer.echo(f"events published to {mqtt}; to follow them: slipflow watch {mqtt}")
    if error := Summary.of(done).error:
        note(f"error: {error}")
        raise typer.Exit(1)


def report(run: "Run", out: Path) -> list[str]:
    """Compare the slips that a demo run recorded in the dataset `out` with the simulated truth, as lines."""
    import numpy as np

    from connectors.sim.simulated_rig import true_slips
    from flows.learn.event_metrics import match_onsets
    from operators import SLIP, Slips, Truth, concat, ms, s
    from storage import Session

    session = Session.open(out / "sessions" / run.session)
    slips = concat(Slips, list(session.read(Slips, 0)))
    onsets = slips.time[slips.state == SLIP]
    found = match_onsets(onsets, true_slips(concat(Truth, list(session.read(Truth, 0)))))
    caught, delays = len(found.delays), found.delays / ms  # (caught,) ms
    rows = ", ".join(f"{run.sources[name].rows} {name}" for name in ("touch", "motion"))
    seconds, recorded = (run.clock.now() - run.start) / s, run.sinks["dataset"].rows
    lines = [
        f"{seconds:.1f} s: {rows} samples in, {recorded} rows recorded",
        f"{caught + found.missed} true slips: {caught} detected, {found.missed} missed",
        f"{len(onsets)} onsets reported, {found.false} of them false",
    ]
    if caught:
        median, p90 = np.quantile(delays, (0.5, 0.9)).tolist()
        lines.append(f"onset delay: median {median:.0f} ms, p90 {p90:.0f} ms")
    python = Path(sys.executable)
    return [
        *lines,
        f"dataset: {out}; to view it, or to open it in Python:",
        f"  {python.parent}/slipflow show {session.folder}",
        f"  {python} -c \"import polars; print(polars.read_parquet('{session.folder}/samples/*.parquet'))\"",
    ]
