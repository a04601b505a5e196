"""The command `slipflow demo`."""

import sys
from pathlib import Path
from shlex import join
from typing import Annotated

import typer

from flows.cli.live_view import add_page
from flows.cli.options import NoBrowser, Recordings
from flows.cli.run import execute, report_run
from flows.cli.terminal import begin_log


def demo(
    *,
    duration: Annotated[
        str, typer.Option("--for", metavar="TIME", help="Stop after this time, such as 30s or 5min.")
    ] = "20s",
    out: Recordings = Path("recordings"),
    no_browser: NoBrowser = False,
) -> None:
    """Detect slip on a simulated rig; no hardware is needed.

    Records a labelled dataset, shows touch and slips on the live page, and compares the detected slips with
    the true ones. Exits as `slipflow run` does; `slipflow run demo` runs the same flow with all options of
    `run`, and publishes the slip events with --set broker=mqtt://localhost.

    Examples:
      slipflow demo --for 1min
    """
    from flows import demo as declared
    from flows.graph.quantity import parse_quantity

    begin_log()
    limit = int(parse_quantity("demo", "--for", duration, "ns"))
    flow = declared.demo(str(out))
    add_page(flow, browse=not no_browser)
    typer.echo(flow, err=True)
    done = execute(flow, limit)
    if not done.error:  # else it was stopped before it began: there is no session
        typer.echo("\n".join(report(out / "sessions" / done.session)))
    report_run(done)


def report(folder: Path) -> list[str]:
    """Compare the slips of the session in a folder with the simulated truth, as lines."""
    import numpy as np

    from connectors.sim.simulated_rig import true_slips
    from flows.learn.event_metrics import match_onsets
    from operators import SLIP, Slips, Truth, concat, ms
    from storage import Session

    session = Session.open(folder)
    slips = concat(Slips, list(session.read(Slips, 0)))
    onsets = slips.time[slips.state == SLIP]
    found = match_onsets(onsets, true_slips(concat(Truth, list(session.read(Truth, 0)))))
    caught = len(found.delays)
    lines = [
        f"{caught + found.missed} true slips: {caught} detected, {found.missed} missed",
        f"{len(onsets)} onsets reported, {found.false} of them false",
    ]
    if caught:
        median, p90 = (np.quantile(found.delays, (0.5, 0.9)) / ms).tolist()
        lines.append(f"onset delay: median {median:.0f} ms, p90 {p90:.0f} ms")
    python = Path(sys.executable)
    code = f'import polars; print(polars.read_parquet("{folder}/samples/*.parquet"))'
    return [
        *lines,
        "to view the recording, or to open it in Python:",
        f"  {join([f'{python.parent}/slipflow', 'show', str(folder)])}",
        f"  {join([str(python), '-c', code])}",
    ]
