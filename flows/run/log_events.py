"""Log events of a run, each with a line of text and structured data."""

import logging
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from operators.batch import s
from operators.errors import SlipflowError
from operators.ports import Gap, Json

log = logging.getLogger("slipflow")


def event(name: str, **about: Json) -> dict[str, Any]:
    """Return the structured data of a log record, for `extra`; `flows.cli.event_log` writes it as JSON.

    >>> event("source_failed", source="touch")
    {'event': 'source_failed', 'about': {'source': 'touch'}}
    """
    return {"event": name, "about": about}


def reason_of(error: Exception) -> str:
    """Return an error's message, with its type unless slipflow or the operating system raised it.

    >>> reason_of(OSError("Connection reset")), reason_of(KeyError("x"))
    ('Connection reset', "KeyError: 'x'")
    """
    return str(error) if isinstance(error, SlipflowError | OSError) else f"{type(error).__name__}: {error}"


def replay_destination(sink: str, destination: str) -> None:
    """Log that a sink writes to another destination than in a live run."""
    extra = event("replay_destination", sink=sink, destination=destination)
    log.warning("%s: the replay is written to %s", sink, destination, extra=extra)


def source_failed(source: str, reason: str) -> None:
    """Log the first failure of a source since it last worked."""
    extra = event("source_failed", source=source, reason=reason)
    log.warning("%s failed, retrying: %s", source, reason, extra=extra)


def source_stale(source: str, reason: str) -> None:
    """Log that a source has not failed, but delivers nothing."""
    hint = "check that it is connected and switched on"
    log.warning("%s %s: %s", source, reason, hint, extra=event("source_stale", source=source, reason=reason))


def source_restarted(source: str, gap: Gap) -> None:
    """Log that a source works again."""
    log.warning("%s works again", source, extra=event("source_restarted", source=source, gap=asdict(gap)))


def sink_failed(sink: str, reason: str) -> None:
    """Log the first failure of a sink since it last worked."""
    log.warning("%s failed: %s", sink, reason, extra=event("sink_failed", sink=sink, reason=reason))


def sink_drops(sink: str) -> None:
    """Log that the queue of a failing sink is full."""
    log.warning("%s drops rows until it works again", sink, extra=event("sink_drops", sink=sink))


def sink_restored(sink: str, dropped: int) -> None:
    """Log that a sink works again, and how many rows were dropped meanwhile."""
    lost = f"; {dropped} rows were dropped" if dropped else ""
    log.warning("%s works again%s", sink, lost, extra=event("sink_restored", sink=sink, dropped=dropped))


def sinks_awaited(sinks: Mapping[str, tuple[int, int]]) -> None:
    """Log that the end of the run waits for sinks, with their queued batches and their unstored rows."""
    text = "; ".join(
        f"{name} ({queued} batches queued, {rows} rows not stored)" for name, (queued, rows) in sinks.items()
    )
    log.warning(
        "waiting for %s; a second signal drops them", text, extra=event("sinks_awaited", sinks=[*sinks])
    )


def clock_set(offset: int, known: int) -> None:
    """Log a step of the host's clock: its offset from the run's clock was `known` and is now `offset`, ns."""
    text = "the host's clock stepped by %+.3f s; time stamps are not affected"
    log.warning(text, (offset - known) / s, extra=event("clock_set", offset_ns=offset))
