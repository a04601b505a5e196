"""What people should know of a run as it happens: each a line for them, an event for programs."""

import logging
from dataclasses import asdict
from typing import Any

from operators.batch import s
from operators.errors import SlipflowError
from operators.ports import Gap, Json

log = logging.getLogger("slipflow")


def event(name: str, **about: Json) -> dict[str, Any]:
    """What a log record tells a program besides its text, as `extra`; `flows.cli.event_log` writes it.

    >>> event("source_failed", source="touch")
    {'event': 'source_failed', 'about': {'source': 'touch'}}
    """
    return {"event": name, "about": about}


def reason_of(error: Exception) -> str:
    """What a failure says of itself; with the name of its type where slipflow or the system did not raise it.

    >>> reason_of(OSError("the cable is out")), reason_of(KeyError("x"))
    ('the cable is out', "KeyError: 'x'")
    """
    return str(error) if isinstance(error, SlipflowError | OSError) else f"{type(error).__name__}: {error}"


def replay_elsewhere(sink: str, place: str) -> None:
    """In a replay it writes to `place`, elsewhere than in a live run."""
    extra = event("replay_elsewhere", sink=sink, place=place)
    log.warning("%s: the replay goes to %s", sink, place, extra=extra)


def source_failed(source: str, reason: str) -> None:
    """It failed, for the first time since it last worked."""
    extra = event("source_failed", source=source, reason=reason)
    log.warning("%s failed, trying again: %s", source, reason, extra=extra)


def source_restarted(source: str, gap: Gap) -> None:
    """It gives rows again."""
    log.warning("%s is back", source, extra=event("source_restarted", source=source, gap=asdict(gap)))


def sink_failed(sink: str, reason: str) -> None:
    """It failed, for the first time since it last worked."""
    log.warning("%s failed: %s", sink, reason, extra=event("sink_failed", sink=sink, reason=reason))


def sink_drops(sink: str) -> None:
    """It has no room for what comes while it fails."""
    log.warning("%s drops rows until it works again", sink, extra=event("sink_drops", sink=sink))


def sink_restored(sink: str, dropped: int) -> None:
    """It takes rows again; so many were dropped meanwhile."""
    lost = f"; {dropped} rows were dropped" if dropped else ""
    log.warning("%s works again%s", sink, lost, extra=event("sink_restored", sink=sink, dropped=dropped))


def clock_set(offset: int, known: int) -> None:
    """The host's clock is `offset` ns off the run's, and was `known`."""
    text = "the host's clock was set by %+.3f s; time stamps go on"
    log.warning(text, (offset - known) / s, extra=event("clock_set", offset_ns=offset))
