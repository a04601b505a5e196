"""Verdicts of the live page on the health of a run: a word and a level for each quantity that has a limit."""

from collections import deque
from collections.abc import Mapping
from typing import Final, Literal, NamedTuple, TypeAlias

from operators.batch import ms, s
from operators.fingertip import RATE_TOLERANCE
from operators.ports import Json, Run, SinkStatus, SourceStatus

Level: TypeAlias = Literal["good", "warning", "bad"]

SLOW: Final = 0.75  # of the declared rate; a lower rate is bad
PERIODS: Final = 2  # a row may be as old as so many periods of its source, and not late
LATE: Final = 50 * ms  # ns, of a fast source
VERY_LATE: Final = 250 * ms  # ns
LOSING: Final = 0.01  # share of lost samples
LOST_FOR: Final = 60 * s  # ns, period of that share
FILLING: Final = 10  # batches in a queue, or events that wait for a broker
BACKLOG: Final = 100
LIMITS: Final = (
    "Sources without a declared rate have no limits. "
    f"Rate: good within {100 * RATE_TOLERANCE:.0f} % of the declared rate. "
    f"Latency: age of the newest row; good up to {LATE // ms} ms or {PERIODS} periods, late up to "
    f"{VERY_LATE // ms} ms. Lost: samples missing at the declared rate or dropped because they came after "
    f"newer ones; judged over the last {LOST_FOR // s} s, few lost below {100 * LOSING:.0f} %. "
    "Queue: batches, and events that the broker has not acknowledged; "
    f"good up to {FILLING}, filling up to {BACKLOG}."
)


class Verdict(NamedTuple):
    """Judgement of one quantity."""

    word: str
    level: Level


GOOD: Final = Verdict("good", "good")


def judge_rate(rate: float, declared: float) -> Verdict:
    """Judge a rate, Hz.

    >>> judge_rate(98.0, 100.0).word, judge_rate(62.8, 100.0), judge_rate(130.0, 100.0).word
    ('good', Verdict(word='slow', level='bad'), 'fast')
    """
    share = rate / declared
    if share > 1 + RATE_TOLERANCE:
        return Verdict("fast", "warning")
    if share >= 1 - RATE_TOLERANCE:
        return GOOD
    return Verdict("slow", "warning" if share >= SLOW else "bad")


def judge_latency(age: float, period: float = 0.0) -> Verdict:
    """Judge the age of the newest row (ns) of a source with a row each `period` (ns).

    >>> judge_latency(12 * ms), judge_latency(120 * ms).word, judge_latency(1042 * ms)
    (Verdict(word='good', level='good'), 'late', Verdict(word='very late', level='bad'))
    """
    if age <= max(LATE, PERIODS * period):
        return GOOD
    return Verdict("late", "warning") if age <= VERY_LATE + PERIODS * period else Verdict("very late", "bad")


def judge_lost(lost: int, samples: int) -> Verdict:
    """Judge lost samples of a period in which `samples` arrived.

    >>> judge_lost(0, 6000).word, judge_lost(3, 6000).word, judge_lost(600, 5400).word
    ('good', 'few lost', 'losing')
    """
    if not lost:
        return GOOD
    return Verdict("few lost", "warning") if lost < LOSING * (lost + samples) else Verdict("losing", "bad")


def judge_queue(waiting: int) -> Verdict:
    """Judge the number of batches or events that wait.

    >>> [judge_queue(waiting).word for waiting in (0, 50, 5000)]
    ['good', 'filling', 'backlog']
    """
    if waiting <= FILLING:
        return GOOD
    return Verdict("filling", "warning") if waiting <= BACKLOG else Verdict("backlog", "bad")


class Verdicts:
    """Verdicts on the sources and sinks of a run; lost samples are judged over the last 60 s."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._counts: dict[str, deque[tuple[int, int, int]]] = {}  # by source: time (ns), rows, lost

    def next(self, rates: Mapping[str, float | None]) -> dict[str, Json]:
        """Judge the current state and the `rates` (Hz) of the sources; call this regularly."""
        now = self._run.clock.now()
        sources = {
            name: self._source(name, source, rates.get(name), now)
            for name, source in self._run.sources.items()
        }
        return {
            "limits": LIMITS,
            "sources": {name: _document(each) for name, each in sources.items()},
            "sinks": {name: _document(_sink(sink)) for name, sink in self._run.sinks.items()},
        }

    def _source(self, name: str, source: SourceStatus, rate: float | None, now: int) -> dict[str, Verdict]:
        counts = self._counts.setdefault(name, deque([(self._run.start, 0, 0)]))
        counts.append((now, source.rows, source.lost))
        while now - counts[0][0] > LOST_FOR:
            counts.popleft()
        declared = source.declared_rate
        if not source.up or declared is None:
            return {}  # the state of the source says enough
        found = {"lost": judge_lost(source.lost - counts[0][2], source.rows - counts[0][1])}
        if source.newest:
            found["latency"] = judge_latency(now - source.newest, s / declared)
        if rate:  # at 0 the latency judges
            found["rate"] = judge_rate(rate, declared)
        return found


def _sink(sink: SinkStatus) -> dict[str, Verdict]:
    dropped = Verdict("losing", "bad") if sink.dropped else GOOD
    return {"queue": judge_queue(max(sink.queued, sink.waiting or 0)), "dropped": dropped}


def _document(verdicts: Mapping[str, Verdict]) -> dict[str, Json]:
    return {name: [*verdict] for name, verdict in verdicts.items()}
