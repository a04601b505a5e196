"""The command that prints slip events as a broker delivers them."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from flows.cli.options import told

if TYPE_CHECKING:
    from connectors.events import Event

# What a command needs is imported inside it: `slipflow --help` must not wait for numpy.
# ruff: noqa: PLC0415


def watch(
    url: Annotated[str, typer.Argument(metavar="URL", help="The broker.")] = "mqtt://localhost",
    *,
    site: Annotated[str, typer.Option(help="Only this site.")] = "+",
    rig: Annotated[str, typer.Option(help="Only this rig; a replay is shown by its name only.")] = "+",
    since: Annotated[
        str, typer.Option(help="now: only what happens; start: first all that the rigs still keep.")
    ] = "now",
    position: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Resume from the position saved in FILE, and save it there."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print each event as one JSON object a line, as it came.")
    ] = False,
) -> None:
    """Print slip events as a broker delivers them, each once.

    The rigs are asked for those that were missed. Beside each stands how soon it was made (of a replay's
    nothing), and how late it came here by this machine's clock, both since the sample that decided. Stops
    at Ctrl-C. What is lost for good is reported, never passed over in silence.
    """
    from contextlib import suppress
    from time import time_ns

    from connectors import Consumer

    if since not in ("now", "start"):
        raise typer.BadParameter(f"--since {since}: write now or start")

    async def show() -> None:
        async with Consumer(
            url, site, rig, position_file=position, since="start" if since == "start" else "now", report=told
        ) as events:
            async for event in events:
                typer.echo(event.encode() if as_json else _line(event, time_ns()))

    with suppress(KeyboardInterrupt):
        asyncio.run(show())


def _line(event: "Event", now: int) -> str:
    """An event that came at `now` (ns): when, where and what it was, how soon it was made, how late it is."""
    from connectors.events import timestamp

    where = f"{event.site}/{event.rig} finger {event.finger}"
    sure = "" if event.probability is None else f"  p {event.probability:.2f}"
    doubt = "".join(f"  barometer {fault.barometer} {fault.kind}" for fault in event.degraded)
    when = timestamp(event.time)[:23].replace("T", " ")
    soon = "" if event.latency is None else f"{event.latency:.1f} ms, "
    late = f"{soon}here after {span(now - event.time)}"
    return f"{when}  {where}  slip {event.state:5}{sure}  {late}{doubt}"


def span(time: int) -> str:
    """So many ns, as a person says it.

    >>> span(12_340_000), span(-3_000_000), span(4 * 10**9), span(7 * 86400 * 10**9)
    ('12.3 ms', '-3.0 ms', '4.0 s', '7.0 days')
    """
    units = (("days", 172_800e9, 86_400e9), ("h", 7200e9, 3600e9), ("min", 120e9, 60e9), ("s", 1e9, 1e9))
    for name, least, one in units:
        if abs(time) >= least:
            return f"{time / one:.1f} {name}"
    return f"{time / 1e6:.1f} ms"
