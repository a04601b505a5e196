import asyncio
import socket

import pytest
from aiohttp import ClientSession

from connectors.web import event_feed as module
from connectors.web.access import Access
from connectors.web.event_feed import QUEUE_MAX, EventFeed, PageQueue, message
from connectors.web.web_server import WebServer
from tests.connectors.mqtt.broker_process import PATIENCE
from tests.connectors.web.reading import events, listening


async def hello() -> bytes:
    return message("hello", {})


async def served(feed: EventFeed) -> WebServer:
    server = WebServer("127.0.0.1", 0, Access(), "a feed")
    await server.open({"/stream": feed.stream})
    return server


def port(server: WebServer) -> int:
    return int(server.url.rpartition(":")[2])


async def read_all(connection: socket.socket) -> None:
    while await asyncio.get_running_loop().sock_recv(connection, 1 << 16):
        pass


def test_a_stalled_browser_is_disconnected_and_uses_bounded_memory() -> None:
    async def main() -> None:
        asked = asyncio.Event()

        async def greet() -> bytes:
            asked.set()
            return await hello()

        feed = EventFeed(greet, stall_timeout=0.3)
        server = await served(feed)
        with socket.socket() as silent:
            silent.connect(("127.0.0.1", port(server)))
            silent.sendall(b"GET /stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
            async with asyncio.timeout(PATIENCE):
                await asked.wait()
                while feed:
                    feed.send("frame", "x" * 100_000)
                    assert feed.queued <= QUEUE_MAX
                    await asyncio.sleep(0.001)
                silent.setblocking(False)  # noqa: FBT003 - socket's own
                with pytest.raises(ConnectionResetError):  # so that the kernel keeps nothing for it either
                    await read_all(silent)
        assert feed.dropped == 1
        await server.close()

    asyncio.run(main())


def test_a_stalled_browser_does_not_delay_closing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CLOSE_TIMEOUT", 0.05)

    async def main() -> None:
        feed = EventFeed(hello, stall_timeout=PATIENCE)
        server = await served(feed)
        async with asyncio.timeout(PATIENCE), listening(server.url) as heard:
            assert (await anext(heard))[0] == "hello"
            with socket.socket() as silent:
                silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                silent.connect(("127.0.0.1", port(server)))
                silent.sendall(b"GET /stream HTTP/1.1\r\nHost: localhost\r\n\r\n")
                while len(feed) < 2:  # noqa: ASYNC110 - nobody tells
                    await asyncio.sleep(0)
                for k in range(20):
                    feed.send("frame", "x" * 100_000)
                    assert await anext(heard) == ("frame", "x" * 100_000), k
                feed.send("end", None)
                await feed.close()
                assert await anext(heard) == ("end", None)  # who reads has all of it
                await server.close()
                silent.setblocking(False)  # noqa: FBT003 - socket's own
                with pytest.raises(ConnectionResetError):
                    await read_all(silent)
            assert not feed

    asyncio.run(main())


def test_a_disconnected_browser_is_removed_at_once() -> None:
    async def main() -> None:
        feed = EventFeed(hello)
        server = await served(feed)
        async with asyncio.timeout(PATIENCE):
            async with ClientSession() as session, session.get(f"{server.url}/stream") as response:
                assert (await anext(events(response)))[0] == "hello"
                assert len(feed) == 1
            while feed:  # noqa: ASYNC110 - nobody tells
                await asyncio.sleep(0)
        assert feed.dropped == 0
        await server.close()

    asyncio.run(main())


def test_messages_sent_during_the_hello_come_after_it() -> None:
    async def main() -> None:
        asked, go = asyncio.Event(), asyncio.Event()

        async def slow() -> bytes:
            asked.set()
            await go.wait()
            return await hello()

        feed = EventFeed(slow)
        server = await served(feed)
        async with listening(server.url) as heard:
            await asked.wait()
            feed.send("frame", 1)
            go.set()
            assert [await anext(heard), await anext(heard)] == [("hello", {}), ("frame", 1)]
            feed.send("end", 2)
            await feed.close()
            assert [each async for each in heard] == [("end", 2)]
        async with ClientSession() as session, session.get(f"{server.url}/stream") as late:
            assert (late.status, await late.text()) == (503, "The run has ended.\n")
        await server.close()

    asyncio.run(main())


def test_a_browser_receives_the_number_of_its_lost_messages() -> None:
    async def main() -> None:
        feed = EventFeed(hello)
        server = await served(feed)
        async with listening(server.url) as heard:
            assert (await anext(heard))[0] == "hello"
            for k in range(15):
                feed.send("frame", chr(97 + k) * 100_000)
            found = [await anext(heard) for _ in range(11)]
            assert [name for name, _ in found] == ["frame"] * 10 + ["lost"]
            assert found[-1] == ("lost", 5)
        await server.close()

    asyncio.run(main())


def test_the_number_of_pages_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PAGES_MAX", 1)

    async def main() -> None:
        feed = EventFeed(hello)
        server = await served(feed)
        async with (
            listening(server.url),
            ClientSession() as session,
            session.get(f"{server.url}/stream") as second,
        ):
            assert second.status == 503
        await server.close()

    asyncio.run(main())


def test_queued_messages_are_joined_in_order() -> None:
    async def main() -> None:
        page = PageQueue()
        page.put(b"a")
        page.put(b"b")
        assert await page.take() == b"ab"
        waiting = asyncio.create_task(page.take())
        await asyncio.sleep(0)
        assert not waiting.done()
        page.put(b"c")
        assert await waiting == b"c"

    asyncio.run(main())


def test_the_oldest_messages_are_lost_and_counted() -> None:
    async def main() -> None:
        page = PageQueue(limit=10)
        for k in range(10):
            page.put(b"%d23" % k)
        assert await page.take() == b"723823923"
        assert page.lost == 7

    asyncio.run(main())


def test_a_message_longer_than_the_queue_is_lost() -> None:
    async def main() -> None:
        page = PageQueue(limit=2)
        page.put(b"123")
        page.put(b"4")
        assert await page.take() == b"4"
        assert page.lost == 1

    asyncio.run(main())


def test_the_end_comes_after_queued_messages() -> None:
    async def main() -> None:
        page = PageQueue()
        page.put(b"last")
        page.end()
        assert await page.take() == b"last"
        assert await page.take() is None

    asyncio.run(main())
