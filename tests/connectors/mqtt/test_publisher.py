import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from connectors.mqtt.broker import Broker
from connectors.mqtt.broker_link import Link
from connectors.mqtt.publisher import Message, Publisher
from operators.errors import EndpointError
from tests.connectors.mqtt.broker_process import TestBroker

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]


def use(broker: TestBroker, body: Callable[[Publisher], Awaitable[None]]) -> None:
    async def main() -> None:
        publisher = Publisher(Broker.parse(broker.url), "mine", "test")
        try:
            await body(publisher)
        finally:
            await publisher.close()

    asyncio.run(main())


def messages(*topics: str) -> deque[Message]:
    return deque(Message(topic, topic.encode(), retain=False) for topic in topics)


def test_messages_go_out_in_order_below_the_topic_over_one_connection(
    broker: TestBroker, links: list[Link]
) -> None:
    listener = broker.listen("mine/#")

    async def body(publisher: Publisher) -> None:
        for some in (messages("a", "b"), messages("c/d"), messages()):
            await publisher.send(some)
            assert not some

    use(broker, body)
    found = [listener.next() for _ in range(3)]
    assert [(each.topic, each.payload) for each in found] == [
        ("mine/a", "a"),
        ("mine/b", "b"),
        ("mine/c/d", "c/d"),
    ]
    assert [link.alive for link in links] == [False]


def test_one_that_is_refused_stays_and_so_do_the_next(tmp_path: Path, links: list[Link]) -> None:
    (tmp_path / "rights").write_text("topic write mine/a\ntopic write mine/c\n")
    broker = TestBroker(tmp_path, "allow_anonymous true", f"acl_file {tmp_path / 'rights'}")

    async def body(publisher: Publisher) -> None:
        some = messages("a", "b", "c")
        for _ in range(2):
            with pytest.raises(EndpointError, match="refuses to publish mine/b: Not authorized"):
                await publisher.send(some)
            assert [message.topic for message in some] == ["b", "c"]
        await publisher.send(messages("c"))

    try:
        use(broker, body)
    finally:
        broker.close()
    assert len(links) == 1  # being refused is no reason to connect anew


def test_after_the_broker_was_away_what_stayed_is_sent_over_a_new_connection(
    broker: TestBroker, links: list[Link]
) -> None:
    async def body(publisher: Publisher) -> None:
        await publisher.send(messages("a"))
        broker.stop()
        some = messages("b", "c")
        for _ in range(2):
            with pytest.raises(EndpointError):
                await publisher.send(some)
        assert len(some) == 2
        await asyncio.to_thread(broker.start)
        listener = await asyncio.to_thread(broker.listen, "mine/#")
        await publisher.send(some)
        assert [listener.next().topic for _ in range(2)] == ["mine/b", "mine/c"]

    use(broker, body)
    assert not links[-1].alive


def test_leaving_without_ever_having_sent_is_no_error(broker: TestBroker, links: list[Link]) -> None:
    async def body(publisher: Publisher) -> None:
        await publisher.close()

    use(broker, body)
    assert not links
