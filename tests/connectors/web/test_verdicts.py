from connectors.web.verdicts import Verdicts
from operators.batch import ms, s
from operators.ports import Json, Run, SinkStatus, SourceStatus
from tests.conftest import SetClock


def words(document: Json, *path: str) -> str:
    """Return the word of a verdict."""
    for name in path:
        assert isinstance(document, dict)
        document = document[name]
    assert isinstance(document, list)
    return str(document[0])


def test_a_slow_late_and_losing_source_is_named_so(run: Run) -> None:
    now = run.clock.now()
    run.sources["touch"] = SourceStatus(
        rows=628, newest=now - 1042 * ms, missing=372, declared_rate=100.0, up=True
    )
    found = Verdicts(run).next({"touch": 62.8})
    assert [words(found, "sources", "touch", name) for name in ("rate", "latency", "lost")] == [
        "slow",
        "very late",
        "losing",
    ]


def test_without_declared_rate_or_data_there_is_no_verdict(run: Run) -> None:
    run.sources["episodes"] = SourceStatus(rows=3, newest=run.start, up=True)
    run.sources["touch"] = SourceStatus(declared_rate=100.0)
    assert Verdicts(run).next({})["sources"] == {"episodes": {}, "touch": {}}


def test_without_rows_since_the_last_report_the_latency_judges(run: Run) -> None:
    now = run.clock.now()
    run.sources["slow"] = SourceStatus(rows=3, newest=now - 4 * s, declared_rate=0.2, up=True)
    run.sources["touch"] = SourceStatus(rows=3, newest=now - 4 * s, declared_rate=100.0, up=True)
    found = Verdicts(run).next({"slow": 0.0, "touch": 0.0})
    assert words(found, "sources", "slow", "latency") == "good"
    assert words(found, "sources", "touch", "latency") == "very late"


def test_lost_samples_are_forgiven_after_a_minute() -> None:
    clock = SetClock(100 * s)
    run = Run("run1", "live", clock, 90 * s)
    touch = run.sources["touch"] = SourceStatus(rows=1000, missing=5, declared_rate=100.0, up=True)
    verdicts = Verdicts(run)
    assert words(verdicts.next({}), "sources", "touch", "lost") == "few lost"
    for _ in range(61):
        clock.time += s
        touch.rows += 100
        verdicts.next({})
    assert words(verdicts.next({}), "sources", "touch", "lost") == "good"


def test_events_that_a_broker_did_not_acknowledge_count_as_queue(run: Run) -> None:
    run.sinks["mqtt"] = SinkStatus(queued=0, waiting=5000)
    run.sinks["dataset"] = SinkStatus(queued=50, dropped=1)
    found = Verdicts(run).next({})
    assert words(found, "sinks", "mqtt", "queue") == "backlog"
    assert words(found, "sinks", "dataset", "queue") == "filling"
    assert words(found, "sinks", "dataset", "dropped") == "losing"
