import asyncio
from collections.abc import Callable
from contextlib import aclosing

import pytest

from connectors import Event, link
from connectors.link import Link
from connectors.testing import TestBroker
from connectors.watch import watch
from operators.errors import EndpointError, ParameterError

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]


def publish(broker: TestBroker, seq: int, rig: str = "ur10", *options: str) -> Event:
    event = Event("lab", rig, "0", "run1", seq, onset=True, time=seq, probability=0.9, latency=1.0)
    broker.publish(f"slip/v1/lab/{rig}/0/event", event.encode().decode(), *options)
    return event


def first(count: int, broker: TestBroker, site: str = "+", rig: str = "+") -> tuple[list[Event], list[str]]:
    """The first events, here those that the broker retains, and what was reported."""

    async def main() -> tuple[list[Event], list[str]]:
        reports = list[str]()
        async with aclosing(watch(broker.url, site, rig, report=reports.append)) as events:
            return [await anext(events) for _ in range(count)], reports

    return asyncio.run(main())


async def until(condition: Callable[[], bool]) -> None:
    for _ in range(1000):
        if condition():
            return
        await asyncio.sleep(0.01)
    pytest.fail("it did not happen within 10 s")


def test_events_of_all_rigs_or_of_one_are_given(broker: TestBroker, links: list[Link]) -> None:
    sent = [publish(broker, 1, "a", "-r"), publish(broker, 2, "b", "-r")]
    events, reports = first(2, broker)
    assert sorted(events, key=lambda event: event.seq) == sent
    assert not reports
    assert first(1, broker, "lab", "b") == ([sent[1]], [])
    assert not any(link.alive for link in links)


def test_what_is_malformed_is_reported_in_one_line_and_left_out(broker: TestBroker) -> None:
    broker.publish("slip/v1/lab/ur10/0/event", "{}", "-r")
    broker.publish("slip/v1/lab/ur10/1/event", "no\njson", "-r")
    sent = publish(broker, 1, "zzz", "-r")
    events, reports = first(1, broker)
    assert events == [sent]
    assert sorted(report.partition(": ")[0] for report in reports) == ["left out"] * 2
    assert "left out: slip/v1/lab/ur10/0/event: data is missing, must be an object" in reports
    assert all(report.isprintable() for report in reports)


def test_a_lost_broker_is_reported_and_followed_again_when_it_is_back(broker: TestBroker) -> None:
    reports = list[str]()

    async def main() -> None:
        publish(broker, 1, "ur10", "-r")
        async with aclosing(watch(broker.url, report=reports.append)) as events:
            assert (await anext(events)).seq == 1
            coming = asyncio.ensure_future(anext(events))
            broker.stop()
            await until(lambda: len(reports) > 1)
            await asyncio.to_thread(broker.start)
            await until(lambda: reports[-1].endswith("connected again"))
            publish(broker, 2)
            assert (await coming).seq == 2

    asyncio.run(main())
    assert "connection lost" in reports[0]
    assert all(report.endswith("trying again") for report in reports[:-1])


def test_what_came_before_the_loss_is_still_given(broker: TestBroker, links: list[Link]) -> None:
    async def main() -> None:
        publish(broker, 1, "ur10", "-r")
        async with aclosing(watch(broker.url, report=lambda _: None)) as events:
            assert (await anext(events)).seq == 1
            publish(broker, 2)
            publish(broker, 3)
            await until(lambda: vars(links[0])["_queue"].qsize() == 2)
            broker.stop()
            await until(lambda: not links[0].alive)
            assert [(await anext(events)).seq for _ in range(2)] == [2, 3]

    asyncio.run(main())


def test_the_oldest_events_that_nobody_reads_are_dropped_and_counted(
    broker: TestBroker, links: list[Link], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "INCOMING", 2)
    reports = list[str]()

    async def main() -> None:
        publish(broker, 1, "ur10", "-r")
        async with aclosing(watch(broker.url, report=reports.append)) as events:
            assert (await anext(events)).seq == 1
            for seq in range(2, 7):
                publish(broker, seq)
            await until(lambda: links[0].dropped == 3)
            assert [(await anext(events)).seq for _ in range(2)] == [5, 6]

    asyncio.run(main())
    assert [report for report in reports if "dropped" in report] == [
        f"{broker.url}: 3 events dropped: they came too fast"
    ]


def test_a_first_connection_that_fails_is_an_error(broker: TestBroker) -> None:
    broker.stop()
    with pytest.raises(EndpointError, match=r"cannot connect: Connection refused$"):
        first(1, broker)


@pytest.mark.parametrize(("site", "rig"), [("#", "+"), ("+", "a/b"), ("", "+")])
def test_what_is_no_name_of_a_rig_is_refused(broker: TestBroker, site: str, rig: str) -> None:
    with pytest.raises(ParameterError, match=r"^watch: "):
        first(1, broker, site, rig)
