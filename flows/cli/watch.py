"""The command `slipflow watch`."""

import asyncio
from typing import TYPE_CHECKING, Annotated, Final

import typer

from flows.cli.terminal import note

if TYPE_CHECKING:
    from connectors.events import Event

_DAY: Final = 86_400 * 10**9  # ns


def watch(
    url: Annotated[
        str, typer.Argument(metavar="URL", help="Address of the MQTT broker.")
    ] = "mqtt://localhost",
    *,
    site: Annotated[str, typer.Option(help="Show only this site; +: all sites.")] = "+",
    rig: Annotated[str, typer.Option(help="Show only this rig; +: all rigs.")] = "+",
    since: Annotated[
        str, typer.Option(help="now: start with new events; start: with all events that the rigs still have.")
    ] = "now",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print each event as received: one JSON object per line.")
    ] = False,
) -> None:
    """Print slip events from an MQTT broker, each once.

    Fetches missed events from the rigs, and reports events that are lost. Each line shows the time from the
    deciding sample to the event, by the clock of the rig, and to the arrival here, by the clock of this
    machine (if less than a day). Exits 2 if it cannot reach the broker at the start; later it reconnects.
    Stops at Ctrl-C.

    Examples:
      slipflow watch mqtt://localhost --site lab
      slipflow watch mqtts://broker --since start --json
    """
    from contextlib import suppress
    from time import time_ns

    from connectors import Consumer

    if since not in ("now", "start"):
        raise typer.BadParameter(f"--since {since}: give now or start")

    async def show() -> None:
        async with Consumer(
            url, site, rig, since="start" if since == "start" else "now", report=note
        ) as events:
            note(f"connected to {url}; waiting for slip events of {site}/{rig}")
            async for event in events:
                typer.echo(event.encode() if as_json else _line(event, time_ns()))

    with suppress(KeyboardInterrupt):
        asyncio.run(show())


def _line(event: "Event", now: int) -> str:
    """Return the line of an event that arrived at `now` (ns)."""
    from connectors.events import timestamp

    where = f"{event.site}/{event.rig} finger {event.finger}"
    probability = "" if event.probability is None else f"  p {event.probability:.2f}"
    quality = f"  {event.quality}: {event.reason}" if event.reason else ""
    when = timestamp(event.time)[:23].replace("T", " ")
    delays = [] if event.latency is None else [f"sensor to event {event.latency:.1f} ms"]
    if abs(now - event.time) < _DAY:
        delays.append(f"sensor to here {(now - event.time) / 1e6:.1f} ms")
    delay = f"  {', '.join(delays)}" if delays else ""
    return f"{when}  {where}  slip {event.state:5}{probability}{delay}{quality}"
